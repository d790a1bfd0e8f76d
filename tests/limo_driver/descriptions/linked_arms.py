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
