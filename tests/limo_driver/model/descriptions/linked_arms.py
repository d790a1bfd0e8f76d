"""Arms whose joints follow others: a gripper of two fingers as URDF, a parallelogram as MJCF."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

_LIMIT = '<limit lower="{}" upper="{}" effort="60" velocity="2"/>'
_LINK = """<link name="{}"><inertial><origin xyz="{}"/><mass value="{}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="{}"/><geometry><cylinder radius="0.02" length="{}"/></geometry></collision>
</link>"""
RATIO, OFFSET = -0.8, 0.01


def gripper(dynamics=""):
    """Three joints that turn, and two fingers; pinocchio has the one that follows first."""
    links = [
        _LINK.format("base", "0 0 0.05", 2, "0 0 0.05", 0.05, i=0.01),
        _LINK.format("turret", "0 0.01 0.1", 3, "0 0 0.12", 0.08, i=0.02),
        _LINK.format("upper", "0.02 0 0.15", 2, "0 0 0.15", 0.14, i=0.015),
        _LINK.format("fore", "0 0.03 0.12", 1.2, "0 0 0.14", 0.12, i=0.01),
        _LINK.format("left", "0 0.01 0.04", 0.4, "0 0.05 0.03", 0.01, i=0.001),
        _LINK.format("right", "0 -0.01 0.05", 0.3, "0 -0.05 0.03", 0.01, i=0.001),
    ]
    turns = [("yaw", "base", "turret", "0 0 1", 0.1), ("shoulder", "turret", "upper", "0 1 0", 0.3)]
    turns += [("elbow", "upper", "fore", "0 1 0", 0.35)]
    joints = [
        f'<joint name="{name}" type="revolute"><origin xyz="0 0 {z}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>{_LIMIT.format(-1.5, 1.5)}</joint>'
        for name, parent, child, axis, z in turns
    ]
    mimic = f'<mimic joint="finger_b" multiplier="{RATIO}" offset="{OFFSET}"/>{dynamics}'
    joints += [
        f'<joint name="{name}" type="prismatic"><origin xyz="0 0 0.3" rpy="0.1 0 0"/>'
        f'<parent link="fore"/><child link="{child}"/><axis xyz="0 1 0"/>'
        f"{_LIMIT.format(low, high)}{follows}</joint>"
        for name, child, low, high, follows in (
            ("finger_a", "right", -0.07, 0.05, mimic),
            ("finger_b", "left", 0, 0.12, ""),
        )
    ]
    return f'<robot name="gripper">{"".join(links + joints)}</robot>'


def parallelogram(friction=""):
    """A fore arm that keeps its direction while the upper arm turns, as rods make it."""
    return f"""<mujoco model="palletiser">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="turret" pos="0 0 0.1">
      <joint name="yaw" axis="0 0 1" range="-2 2" actuatorfrcrange="-60 60"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.15" size="0.04" mass="3"/>
      <body name="upper" pos="0 0 0.2">
        <joint name="shoulder" axis="0 1 0" range="-1 1" actuatorfrcrange="-90 90"{friction}/>
        <geom type="capsule" fromto="0 0 0.05 0.02 0 0.35" size="0.03" mass="2"/>
        <body name="fore" pos="0 0 0.4">
          <joint name="level" axis="0 1 0" range="-1.2 1.2"{friction}/>
          <geom type="capsule" fromto="0.06 0 0 0.3 0.01 0" size="0.03" mass="1.5"/>
          <body name="hand" pos="0.36 0 0">
            <joint name="wrist" axis="1 0 0" range="-2 2" actuatorfrcrange="-20 20"/>
            <geom type="box" pos="0.05 0.02 0" size="0.03 0.05 0.02" mass="0.8"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality>
    <joint joint1="level" joint2="shoulder" polycoef="0.1 -1 0 0 0"/>  <!-- the rods -->
  </equality>
</mujoco>
"""


def torque_of_tree(text, followers, q, v, a):
    """What pinocchio says of a tree of links whose joints are held together, (T, n), reduced.

    Args:
        text: URDF.
        followers: Leader, ratio and offset of each joint that follows, by name.
        q: Of the joints that move on their own, in the order of the tree (T, n); v and a likewise.
    """
    tree = pin.buildModelFromXML(text)
    data, names = tree.createData(), list(tree.names)[1:]
    own = [name for name in names if name not in followers]
    G, b = np.zeros((len(names), len(own))), np.zeros(len(names))
    for row, name in enumerate(names):
        leader, ratio, offset = followers.get(name, (name, 1.0, 0.0))
        G[row, own.index(leader)], b[row] = ratio, offset
    rows = zip(q, v, a, strict=True)
    return np.array([G.T @ pin.rnea(tree, data, G @ x + b, G @ y, G @ z) for x, y, z in rows])


def pincers(prefix="", at="0 0 0"):
    """Body of an arm, and its equalities: three joints, and a hand whose fingers are four-bars."""
    bar = '<body name="{p}{s}_{name}" pos="0 {y} {z}"><joint name="{p}{s}_{name}" class="{p}bar"/>'
    bar += '<geom class="{p}bar" fromto="0 0 0 0 {to_y} {to_z}"/>{more}</body>'
    fingers = equalities = ""
    for side, sign in (("left", 1), ("right", -1)):
        tip = bar.format(
            p=prefix, s=side, name="tip", y=sign * 0.04, z=0.04, to_y=0, to_z=0.05, more=""
        )
        for name, y, more in (("driver", 0.01, tip), ("spring", 0.03, "")):
            fingers += bar.format(
                p=prefix,
                s=side,
                name=name,
                y=sign * y,
                z=0.1,
                to_y=sign * 0.04,
                to_z=0.04,
                more=more,
            )
        equalities += (
            f'<connect body1="{prefix}{side}_tip" body2="{prefix}{side}_spring"'
            f' anchor="0 {sign * 0.02} 0"/>'
        )
    equalities += (
        f'<joint joint1="{prefix}right_driver" joint2="{prefix}left_driver" polycoef="0 -1 0 0 0"/>'
    )
    body = f"""<body name="{prefix}turret" pos="{at}" childclass="{prefix}arm">
      <joint name="{prefix}yaw" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.04" mass="3"/>
      <body name="{prefix}upper" pos="0 0 0.25">
        <joint name="{prefix}shoulder"/>
        <geom type="capsule" fromto="0 0 0 0.02 0 0.3" size="0.03" mass="2"/>
        <body name="{prefix}fore" pos="0 0 0.35">
          <joint name="{prefix}elbow" class="{prefix}small"/>
          <geom type="capsule" fromto="0 0 0 0 0.02 0.25" size="0.03" mass="1.2"/>
          <body name="{prefix}hand" pos="0 0 0.3">
            <geom type="box" size="0.03 0.05 0.05" pos="0 0 0.05" mass="0.5"/>{fingers}</body>
        </body>
      </body>
    </body>"""
    return body, equalities


def pincer_arm(prefixes=("",)):
    """Arms as they are published: classes of defaults, servos, a hand moved by a tendon."""
    bodies = equalities = defaults = servos = tendons = ""
    for k, prefix in enumerate(prefixes):
        body, held = pincers(prefix, f"0 {k} 0.1")
        bodies, equalities = bodies + body, equalities + held
        defaults += f"""<default class="{prefix}arm">
        <joint axis="0 1 0" range="-1.8 1.8" armature="0.1" actuatorfrcrange="-80 80"/>
        <general gaintype="fixed" biastype="affine" gainprm="900" biasprm="0 -900 -60"/>
        <default class="{prefix}small"><joint range="-2 2" actuatorfrcrange="-30 30"/>
          <general gainprm="300" biasprm="0 -300 -20"/></default>
        <default class="{prefix}bar">
          <joint axis="1 0 0" range="-0.8 0.8" actuatorfrcrange="-1000 1000" armature="0.001"/>
          <geom type="capsule" size="0.005" mass="0.05" contype="0" conaffinity="0"/></default>
      </default>"""
        for name in ("yaw", "shoulder", "elbow"):
            kind = "small" if name == "elbow" else "arm"
            servos += (
                f'<general class="{prefix}{kind}" name="{prefix}{name}" joint="{prefix}{name}"/>'
            )
        tendons += f'<fixed name="{prefix}split">' + "".join(
            f'<joint joint="{prefix}{side}_driver" coef="{coef}"/>'
            for side, coef in (("left", 0.5), ("right", -0.5))
        )
        tendons += "</fixed>"
        servos += (
            f'<general name="{prefix}fingers" tendon="{prefix}split" biastype="affine"'
            ' gainprm="80" biasprm="0 -100 -10"/>'
        )
    return f"""<mujoco model="pincer arm">
  <compiler angle="radian" autolimits="true"/>
  <default>{defaults}</default>
  <worldbody>{bodies}</worldbody>
  <equality>{equalities}</equality>
  <tendon>{tendons}</tendon>
  <actuator>{servos}</actuator>
</mujoco>
"""
