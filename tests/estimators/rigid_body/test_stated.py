"""What a description states beside bodies stays, where a motion does not tell otherwise."""

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.physics import Armature, CoulombFriction, Simulation, SpringLoad

ARM = """<mujoco><worldbody>
  <body><joint name="a" axis="0 0 1" armature="0.08"/>
    <geom type="capsule" fromto="0 0 0 0 0.1 0.3" size="0.05" mass="4"/>
    <body pos="0 0.1 0.3"><joint name="b" axis="0 1 0" armature="0.08"/>
      <geom type="capsule" fromto="0 0 0 0.02 0.02 0.3" size="0.04" mass="2"/>
    </body>
  </body>
</worldbody></mujoco>"""


SPRING = '<joint name="b" stiffness="6" springref="0.35" '


def moved(pace):
    """Half a minute of sinusoids."""
    time = np.arange(0, 30, 0.01)
    rate = pace * 2 * np.pi * np.array([0.13, 0.21])
    phase = np.outer(time, rate) + np.arange(2)
    q, v, a = 0.8 * np.sin(phase), 0.8 * rate * np.cos(phase), -0.8 * rate**2 * np.sin(phase)
    return limo.Motion(time, q, v, a)


def measured(simulation, motion):
    torque = simulation.predict(motion)
    torque += np.random.default_rng(0).normal(0, 0.02, torque.shape)
    return limo.Recording.from_arrays(motion.time, motion.position, torque)


@pytest.mark.parametrize(("pace", "true", "kept"), [(0.05, 0.08, True), (2.0, 0.02, False)])
def test_stated_armature_stays_where_it_is_not_told(tmp_path, pace, true, kept):
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    place = str(tmp_path / "arm.xml")
    effects = [
        *(CoulombFriction(joint=j, tau_c=0.5, v_eps=0.005) for j in (1, 2)),
        *(Armature(joint=j, inertia=true) for j in (1, 2)),
    ]
    recording = measured(Simulation(place, tuple(effects)), moved(pace))
    found = limo.identify(place, recording, tolerance=0.02)
    armature = [e.inertia for e in found.simulation.effects if isinstance(e, Armature)]
    said = "armature of joint 1, 2 stays as the description states it: the motion does not tell it"
    assert (said in found.warnings) == kept
    assert armature == (
        pytest.approx([0.08, 0.08]) if kept else pytest.approx([true] * 2, abs=0.01)
    )


def test_a_stated_spring_is_no_inertia_and_stays(tmp_path):
    text = ARM.replace("<mujoco>", '<mujoco><compiler angle="radian"/>')
    (tmp_path / "arm.xml").write_text(text.replace('<joint name="b" ', SPRING), encoding="utf-8")
    stated = Simulation.load(tmp_path / "arm.xml")
    found = limo.identify(stated.model, measured(stated, moved(1.0)))
    springs = [e for e in found.simulation.effects if isinstance(e, SpringLoad)]
    assert springs == [e for e in stated.effects if isinstance(e, SpringLoad)]
    assert [link.mass for link in found.links] == pytest.approx([4, 2], rel=0.03)
    assert found.rmse_consistent.max() < 0.02
