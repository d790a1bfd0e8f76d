"""The steps to a first motion of an arm on a CAN bus, with faults put in."""

import json
import re

import numpy as np
import pytest
from first_motions import CanBench

from backends.can.config import CONVENTIONS, DAMIAO
from backends.can.robot import CanRobot
from backends.can.simulator.scenario import FROM_DRIVES, LostFrames, SwappedJoints
from limo_driver.app.library.first_motion.records import STEPS
from limo_driver.app.library.first_motion.steps import take_step
from limo_driver.app.library.first_motion.watching import ShadowRobot
from limo_driver.errors import BackendError, ConfigError
from limo_driver.physics import GravityDirection, Payload, Simulation
from limo_driver.physics.effects.sensing import TorqueOffset
from limo_driver.types import PositionCommand

CONVENTION = pytest.mark.parametrize("convention", CONVENTIONS)


def arm_with(effect):
    return Simulation("iiwa14", effects=(effect,))


def received(bench, folder):
    """Take the first two steps; return the problems of the second."""
    assert take_step(bench.arm, folder, settings=bench.settings).passed
    done = take_step(bench.arm, folder, settings=bench.settings)
    assert done.record["step"] == "receive"
    return done, [each for each in done.found.findings if each.problem]


@CONVENTION
@pytest.mark.slow("plans, computes and makes two motions")
def test_all_steps_are_passed_in_their_order_and_nothing_moves_in_the_first_three(
    tmp_path, monkeypatch, convention
):
    bench = CanBench(convention=convention).plug(monkeypatch)
    for step in STEPS:
        before = len(bench.set_points)
        done = take_step(bench.arm, tmp_path / "kept", settings=bench.settings)
        assert (done.record["step"], done.record["verdict"]) == (step, "passed"), done.record
        assert (len(bench.set_points) > before) is (step in {"one-joint", "limopa"})
        assert done.page.read_text().count("passed") > 0
        assert done.record["address"].startswith("CAN virtual limo-")
    record = json.loads((tmp_path / "kept" / "4_one_joint.json").read_text())
    travel = np.degrees(record["figures"]["travel"])
    assert np.abs(travel[:, 6]).max() == pytest.approx(2.0, abs=0.1)
    assert np.abs(travel[:, :6]).max() < 0.1
    assert record["figures"]["limited"] == {}


WRONG = {
    "tool": (
        (), arm_with(Payload(mass=4.0, com=(0.0, 0.0, 0.12))), "tool-mass", r"[34](\.\d)? kg more",
    ),
    "exchanged": ((SwappedJoints(joint=2, other=4),), None, "exchanged-joints", "joints 2 and 4"),
    "mounting": (
        (), arm_with(GravityDirection(gravity=(9.81, 0, 0))), "mounting", r"turned by 9\d°",
    ),
    "offset": (
        (), arm_with(TorqueOffset(joint=4, offset=9.0)), "sensor-offset", r"joint 4 by \+[89]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", WRONG)
def test_faults_are_named_in_one_line_before_anything_moves(tmp_path, monkeypatch, fault):
    faults, simulation, kind, expected = WRONG[fault]
    bench = CanBench(faults, simulation).plug(monkeypatch)
    done, problems = received(bench, tmp_path)
    named = next(each for each in problems if each.code == kind)
    assert re.search(expected, named.text)
    assert "\n" not in named.text
    assert kind in done.page.read_text()
    assert bench.set_points == []
    with pytest.raises(ConfigError, match=r"step 3 \(shadow\) is refused, and nothing moves"):
        take_step(bench.arm, tmp_path, "shadow", bench.settings)


@pytest.mark.slow("plans and computes two motions")
@pytest.mark.parametrize("fault", WRONG)
def test_motors_without_torque_sensors_are_judged_while_they_hold_before_a_joint_moves(
    tmp_path, monkeypatch, fault
):
    faults, simulation, kind, expected = WRONG[fault]
    bench = CanBench(faults, simulation, convention=DAMIAO).plug(monkeypatch)
    done, problems = received(bench, tmp_path)
    assert problems == []
    assert "no-torque" in {each.code for each in done.found.findings}
    assert take_step(bench.arm, tmp_path, settings=bench.settings).passed
    done = take_step(bench.arm, tmp_path, settings=bench.settings)
    assert (done.record["step"], done.record["verdict"]) == ("one-joint", "failed")
    named = next(each for each in done.found.findings if each.problem)
    assert kind == named.code
    assert re.search(expected, named.text)
    assert not (tmp_path / "4_one_joint.parquet").exists()  # it only held
    with pytest.raises(ConfigError, match=r"step 5 \(LIMOPA\) is refused, and nothing moves"):
        take_step(bench.arm, tmp_path, "limopa", bench.settings)


@CONVENTION
def test_a_loose_cable_is_named_with_its_joint(tmp_path, monkeypatch, convention):
    loose = LostFrames(at=1.0, lasts=0.1, probability=1.0, joint=3, way=FROM_DRIVES)
    _, problems = received(CanBench((loose,), convention=convention).plug(monkeypatch), tmp_path)
    named = next(each for each in problems if each.code == "loose-cable")
    assert re.search(
        r"measurements of joint 3 stayed away 1 time, for up to (90|100) ms", named.text
    )


def test_an_arm_that_nobody_guides_does_not_pass(tmp_path, monkeypatch):
    _, problems = received(CanBench(guided=False).plug(monkeypatch), tmp_path)
    assert [each.code for each in problems] == ["poses"]
    assert problems[0].text.startswith("1 of 3 poses at rest were seen")


@CONVENTION
def test_a_drive_that_is_not_there_is_named_by_the_first_step(tmp_path, monkeypatch, convention):
    lost = LostFrames(probability=1.0, joint=5)
    bench = CanBench((lost,), convention=convention).plug(monkeypatch)
    bench.bus.time += 0.1
    bench.bus.station.turn()  # the fault begins
    done = take_step(bench.arm, tmp_path, settings=bench.settings)
    assert not done.passed
    assert "joint 5 (node 15) does not answer" in done.record["findings"][0]["text"]


def test_a_motion_that_was_changed_after_it_was_shadowed_is_refused(tmp_path, monkeypatch):
    bench = CanBench().plug(monkeypatch)
    for _ in range(3):
        assert take_step(bench.arm, tmp_path, settings=bench.settings).passed
    file = tmp_path / "4_one_joint.traj.parquet"
    file.write_bytes((tmp_path / "5_limopa.traj.parquet").read_bytes())
    before = len(bench.set_points)
    with pytest.raises(ConfigError, match="is not the motion that was shadowed"):
        take_step(bench.arm, tmp_path, settings=bench.settings)
    assert len(bench.set_points) == before


@CONVENTION
def test_who_listens_only_is_refused_to_command_and_sends_no_set_point(monkeypatch, convention):
    bench = CanBench(guided=False, convention=convention).plug(monkeypatch)
    with CanRobot(bench.config, listen_only=True) as robot:
        state = robot.receive()
        with pytest.raises(BackendError, match="listen only"):
            robot.send(PositionCommand(position=state.position))
        robot.hold("to see whether that says anything to the drives")
        for _ in range(20):
            robot.receive()
    assert bench.set_points == []
    assert not any(drive.enabled for drive in bench.bus.station.drives)


@CONVENTION
def test_a_shadow_says_what_the_contract_would_have_limited_and_sends_nothing(
    monkeypatch, convention
):
    bench = CanBench(guided=False, convention=convention).plug(monkeypatch)
    with ShadowRobot(CanRobot(bench.config, listen_only=True)) as shadow:
        start = shadow.receive().position
        assert shadow.send(PositionCommand(position=start)).limited_by == ()
        shadow.receive()
        far = shadow.send(PositionCommand(position=start + 1.0))
        assert "velocity" in far.limited_by or "acceleration" in far.limited_by
        shadow.receive()
    assert bench.set_points == []
