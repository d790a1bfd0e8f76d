"""Arms as MJCF that nobody designed: random axes, anchors, references and classes of joints."""

from __future__ import annotations

import mujoco
import numpy as np

GRAVITY = (0.3, -0.4, -9.7)


def arm_of(seed, joints=4, dynamics=True, inertials=True):
    """An MJCF file with comments, defaults, a scene and a gripper-like fixed body."""
    random = np.random.default_rng(seed)

    def vector(scale=1.0, size=3):
        return " ".join(f"{x:.5f}" for x in scale * random.normal(size=size))

    lines = [
        '<mujoco model="made up">',
        "  <!-- kept as it is -->",
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option gravity="{" ".join(map(str, GRAVITY))}" timestep="0.001"/>',
        "  <default>",
        '    <default class="big"><joint armature="0.1" damping="1.5"/></default>',
        "  </default>",
        "  <worldbody>",
        '    <geom name="floor" type="plane" size="1 1 0.1"/>',
    ]
    close = []
    for j in range(joints):
        pad = "    " + "  " * j
        lines.append(f'{pad}<body name="link{j}" pos="{vector(0.2)}" quat="{vector(1.0, 4)}">')
        if inertials:
            mass = random.uniform(0.5, 4.0)
            moments = random.uniform(0.8, 1.2, 3) * 0.02 * mass
            lines.append(
                f'{pad}  <inertial pos="{vector(0.05)}" quat="{vector(1.0, 4)}" mass="{mass:.4f}" '
                f'diaginertia="{moments[0]:.5f} {moments[1]:.5f} {moments[2]:.5f}"/>'
            )
        own = ""
        if dynamics and j % 2:
            own = (
                f' frictionloss="{random.uniform(0.1, 2):.3f}" damping="{random.uniform(0, 2):.3f}"'
                f' stiffness="{random.uniform(0, 3):.3f}" springref="{random.normal():.3f}"'
            )
        named = ' class="big"' if dynamics and not j % 2 else ""
        lines.append(
            f'{pad}  <joint name="hinge{j}"{named} axis="{vector()}" pos="{vector(0.03)}" '
            f'ref="{random.normal() * 0.3:.4f}" range="-3 3"{own} actuatorfrcrange="-80 80"/>'
        )
        lines.append(f'{pad}  <geom type="capsule" size="0.03 0.1" mass="0.7"/>')
        close.append(f"{pad}</body>")
    pad = "    " + "  " * joints
    lines += [
        f'{pad}<body name="tool" pos="{vector(0.1)}"><!-- fixed -->',
        f'{pad}  <geom type="box" size="0.02 0.03 0.04" mass="0.3"/>',
        f'{pad}  <site name="tip" pos="0 0 0.05"/>',
        f"{pad}</body>",
        *reversed(close),
        "  </worldbody>",
        "</mujoco>",
        "",
    ]
    return "\n".join(lines)


def torques(model, q, v, a):
    """What MuJoCo says an arm needs, rigid body and passive forces, (T, n)."""
    data, found = mujoco.MjData(model), np.zeros_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        found[k] = data.qfrc_inverse
    return found


def plain(model):
    """The same without contact."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return model
