"""The steps to a first motion of an iiwa over FRI, with faults put in; real UDP."""

import re

import numpy as np
import pytest
from first_motions import FriBench, quick

from backends.fri.codec.messages import SessionState
from backends.fri.robot import FriRobot
from backends.fri.simulator.scenario import Direction, Exchange, Loss
from limo_driver.app.library.first_motion.steps import take_step
from limo_driver.app.library.first_motion.watching import WatchSettings
from limo_driver.errors import BackendError, ConfigError
from limo_driver.physics import GravityDirection, Payload, Simulation
from limo_driver.physics.effects.sensing import TorqueOffset
from limo_driver.types import PositionCommand

pytestmark = pytest.mark.waits


@pytest.fixture
def bench(monkeypatch):
    return FriBench(monkeypatch)


def arm_with(effect):
    return Simulation("iiwa14", effects=(effect,))


def was_in(robot, state):
    """Say whether the session of a controller was ever in a state."""
    return any(visit.state is state for visit in robot.visits)


def said(done):
    return done.record["step"], done.record["verdict"], done.record["findings"]


@pytest.mark.slow("plans two motions and computes them over UDP")
def test_a_monitored_arm_passes_the_first_three_steps_and_is_never_commanded(bench, tmp_path):
    for step in ("link", "receive", "shadow"):
        with bench.controller(guided=step == "receive") as robot:
            done = take_step(bench.arm, tmp_path, settings=quick())
            assert said(done)[:2] == (step, "passed"), said(done)
            assert robot.findings.largest_step == 0.0
            assert not was_in(robot, SessionState.COMMANDING_WAIT)
    assert done.record["address"] == f"FRI 127.0.0.1, port {bench.port}"


@pytest.mark.parametrize(
    ("events", "simulation", "kind", "words"),
    [
        ((), arm_with(Payload(mass=4.0, com=(0.0, 0.0, 0.12))), "tool-mass", "kg more"),
        (
            (Exchange(at=0.0, duration=1e6, joint=2, other=4),),
            None,
            "exchanged-joints",
            "joints 2 and 4",
        ),
        ((), arm_with(GravityDirection(gravity=(0, 9.81, 0))), "mounting", "turned by 90°"),
        ((), arm_with(TorqueOffset(joint=2, offset=15.0)), "sensor-offset", r"joint 2 by \+15"),
        (
            (Loss(at=1.2, duration=0.1, fraction=1.0, direction=Direction.TO_CLIENT),),
            None,
            "loose-cable",
            "measurements stayed away",
        ),
    ],
    ids=["tool", "exchanged", "mounting", "offset", "cable"],
)
def test_faults_are_named_in_one_line_before_anything_moves(
    bench, tmp_path, events, simulation, kind, words
):
    bench.pass_link(tmp_path)
    with bench.controller(*events, simulation=simulation, guided=True) as robot:
        done = take_step(bench.arm, tmp_path, settings=quick())
        assert not was_in(robot, SessionState.COMMANDING_WAIT)
    named = next((each for each in done.found.findings if each.code == kind), None)
    assert named is not None, said(done)
    assert named.problem
    assert re.search(words, named.text)
    assert "\n" not in named.text
    with pytest.raises(ConfigError, match=r"step 3 \(shadow\) is refused, and nothing moves"):
        take_step(bench.arm, tmp_path, "shadow", quick())


def test_an_application_that_asks_for_commands_is_not_answered_and_named(bench, tmp_path):
    with bench.controller(monitors=False, patient=False) as robot:
        done = take_step(bench.arm, tmp_path, settings=quick(link_seconds=1.0))
        assert was_in(robot, SessionState.COMMANDING_WAIT)
        assert not was_in(robot, SessionState.COMMANDING_ACTIVE)
    assert "asks-for-commands" in [each.code for each in done.found.findings if each.problem]


def test_who_listens_only_is_refused_to_command(bench):
    with bench.controller(), FriRobot("127.0.0.1", bench.port, listen_only=True) as robot:
        state = robot.receive(60.0)
        with pytest.raises(BackendError, match="listen only"):
            robot.send(PositionCommand(position=state.position))


def test_an_address_at_which_nobody_speaks_has_the_status_of_the_examination(bench, tmp_path):
    done = take_step(bench.arm, tmp_path, settings=quick(link_seconds=0.1))
    assert done.found.status == 3
    assert done.record["findings"][0]["code"] == "nobody"


@pytest.mark.slow("two motions, cycle by cycle over UDP")
def test_the_last_two_steps_move_the_arm_as_it_was_shadowed(bench, tmp_path):
    still = WatchSettings(duration=1.0, still=0.15, poses=1, most_late=1.0)
    bench.pass_link(tmp_path)
    for step in ("receive", "shadow", "one-joint", "limopa"):
        commands = step in {"one-joint", "limopa"}
        with bench.controller(monitors=not commands) as robot:
            done = take_step(bench.arm, tmp_path, settings=quick(watch=still))
            assert said(done)[:2] == (step, "passed"), said(done)
            assert was_in(robot, SessionState.COMMANDING_ACTIVE) is commands
    travel = np.array(done.record["figures"]["travel"])
    assert np.ptp(travel, axis=0).max() > 0.05


@pytest.mark.slow("a motion, cycle by cycle over UDP")
def test_an_arm_whose_joints_are_exchanged_is_stopped_and_nothing_goes_on(bench, tmp_path):
    still = WatchSettings(duration=1.0, still=0.15, poses=1, most_late=1.0)
    bench.pass_link(tmp_path)
    for _ in range(2):
        with bench.controller():
            assert take_step(bench.arm, tmp_path, settings=quick(watch=still, joint=1)).passed
    exchanged = Exchange(at=0.0, duration=1e6, joint=1, other=3)  # both stand at 0
    with bench.controller(exchanged, monitors=False):
        done = take_step(bench.arm, tmp_path, settings=quick())
    (problem,) = [each for each in done.found.findings if each.problem]
    assert problem.code in {"wrong-joint", "not-following", "contact"}, said(done)
    assert "braked to rest" in problem.text
    assert max(np.abs(np.degrees(done.record["figures"]["travel"])).ravel()) < 1.5
    with pytest.raises(ConfigError, match=r"step 5 \(LIMOPA\) is refused, and nothing moves"):
        take_step(bench.arm, tmp_path, "limopa", quick())
