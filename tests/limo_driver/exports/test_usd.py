"""What was found lies over a USD asset as a layer, which limo and USD read back."""

from dataclasses import replace

import numpy as np
import pytest
from usd_arms import usd_of

import limo_driver as limo
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.physics import (
    Armature,
    CoulombFriction,
    Payload,
    Simulation,
    TorqueOffset,
    ViscousFriction,
)

pytest.importorskip("pxr", reason="needs usd-core: pip install limo[usd]")


@pytest.fixture
def asset(tmp_path):
    return usd_of(RobotModel.load("iiwa14"), tmp_path / "arm.usda")


def found_on(asset):
    simulation = Simulation.load(asset)
    effects = [Payload(mass=1.5, com=(0.01, 0, 0.08), inertia=(0.004, 0, 0, 0.004, 0, 0.002))]
    for joint in range(1, 8):
        effects += [
            CoulombFriction(joint=joint, tau_c=2.0 / joint, v_eps=0.003),
            ViscousFriction(joint=joint, f_v=3.0 / joint),
            Armature(joint=joint, inertia=0.4 / joint),
        ]
    return replace(simulation, effects=tuple(effects))


def test_what_was_found_is_a_layer_over_the_file(asset, tmp_path):
    from pxr import Usd

    before = asset.read_bytes()
    written = limo.export(found_on(asset), "usd", tmp_path / "found")
    assert asset.read_bytes() == before
    assert not written.remainder
    assert written.share < 1e-4
    stage = Usd.Stage.Open(str(written.file))
    prims = {prim.GetName(): prim for prim in stage.Traverse()}
    joint = prims["turns_joint2"]
    axis = "physxJointAxis:angular"
    assert joint.GetAttribute(f"{axis}:armature").Get() == pytest.approx(0.2)
    assert joint.GetAttribute(f"{axis}:dynamicFrictionEffort").Get() == pytest.approx(1.0)
    per_degree = joint.GetAttribute(f"{axis}:viscousFrictionCoefficient").Get()
    assert per_degree == pytest.approx(1.5 * np.pi / 180)
    assert joint.GetAttribute("custom:serial").Get() == "kept"
    assert stage.GetDefaultPrim().GetName() == "robot"


@pytest.mark.slow("writes four files")
def test_a_later_export_over_a_layer_says_what_changed_since(asset, tmp_path):
    found, masses = found_on(asset), lambda file: RobotModel(file).inertials["link7"].mass
    first = limo.export(found, "usd", tmp_path / "1").file
    again = limo.export(found, "usd", tmp_path / "2", into=first)
    assert "over" not in again.diff.replace("overs", "")
    assert masses(again.file) == pytest.approx(masses(first))
    lighter = replace(found, effects=(Payload(mass=0.5, com=(0, 0, 0.1)),))
    second = limo.export(lighter, "usd", tmp_path / "3", into=first)
    own = masses(asset)
    assert (masses(first), masses(second.file)) == pytest.approx((own + 1.5, own + 0.5))
    assert "joint turns_joint1: dry friction 2 N m, which an earlier" in second.dropped[0]
    none = limo.export(Simulation(str(asset)), "usd", tmp_path / "4", into=second.file)
    assert masses(none.file) == pytest.approx(own)
    assert RobotModel(none.file).description.dynamics == (RobotModel(asset).description.dynamics)


def test_there_and_back(asset, tmp_path):
    simulation = found_on(asset)
    again = Simulation.load(limo.export(simulation, "usd", tmp_path / "found").file)
    random = np.random.default_rng(0)
    q, v, a = random.uniform(-1, 1, (3, 200, 7))
    v += 0.1 * np.sign(v)  # friction at rest is smoothed over, in each simulation its own way
    motion = limo.Motion(0.01 * np.arange(200), q, v, a)
    np.testing.assert_allclose(again.predict(motion), simulation.predict(motion), atol=2e-3)
    unchanged = limo.export(Simulation.load(asset), "usd", tmp_path / "same")
    assert "physxJointAxis" not in unchanged.file.read_text(encoding="utf-8")
    assert "physics:mass" not in unchanged.file.read_text(encoding="utf-8")


def test_what_is_not_expressible_is_said(asset, tmp_path):
    simulation = replace(Simulation.load(asset), effects=(TorqueOffset(joint=2, offset=0.3),))
    (left,) = limo.export(simulation, "usd", tmp_path / "found").remainder
    assert str(left) == "torque_offset, joint 2 is not expressible: 0.3 N m RMS remain (joint 2)"


def test_an_export_needs_a_file_to_lie_over(tmp_path):
    with pytest.raises(ConfigError, match="give it with `into`"):
        limo.export(Simulation("iiwa14"), "usd", tmp_path / "out")
