"""The parts of the simulated controller that need no bytes: session, quality, link, scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from backends.fri.codec.messages import Quality, SafetyState, SessionState
from backends.fri.simulator.connection.port import (
    UNDISTURBED,
    Channel,
    ConnectionQuality,
    Disturbance,
    QualityModel,
)
from backends.fri.simulator.scenario import (
    ControllerScenario,
    Delay,
    Direction,
    FlangeForce,
    Loss,
    ScenarioClock,
    SimulatedPush,
)
from backends.fri.simulator.session import Circumstances, ControllerSession, SessionTimes
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

IDLE, WAIT, READY, ASKED, ACTIVE = SessionState
GOOD = Circumstances(Quality.GOOD, confirmed=99)


def test_a_session_goes_up_one_state_at_a_time() -> None:
    session = ControllerSession(SessionTimes(monitor=0.05))
    for cycle in range(100):
        session.update(1e-3 * cycle, GOOD)
    assert [visit.state for visit in session.visits] == [IDLE, WAIT, READY, ASKED, ACTIVE]
    assert session.visits[3].at == pytest.approx(session.visits[2].at + 0.05)


@pytest.mark.parametrize(
    ("given", "state"),
    [
        (Circumstances(Quality.FAIR, 99), WAIT),
        (Circumstances(Quality.GOOD, 99, stop="joint 1 jumps"), READY),
        (Circumstances(Quality.GOOD, 99, cap=IDLE), IDLE),
        (Circumstances(Quality.GOOD, 99, cap=ASKED), ASKED),
        (Circumstances(Quality.POOR, 99, stop="joint 1 jumps"), WAIT),
    ],
)
def test_what_leads_down_and_how_far(given: Circumstances, state: SessionState) -> None:
    session = ControllerSession(SessionTimes(monitor=0.0))
    for cycle in range(10):
        session.update(1e-3 * cycle, GOOD)
    assert session.active
    assert session.update(0.1, given) is state


def test_after_a_stop_the_application_asks_again_only_later() -> None:
    session = ControllerSession(SessionTimes(monitor=0.01, restart=0.2))
    times = {}
    for cycle in range(400):
        now = 1e-3 * cycle
        stop = "stopped" if 0.05 <= now < 0.07 else ""
        state = session.update(now, Circumstances(Quality.GOOD, 99, stop=stop))
        times.setdefault((state, now > 0.05), now)
    assert times[ASKED, True] == pytest.approx(0.069 + 0.2)
    assert "stopped" in [visit.reason for visit in session.visits]


def test_without_confirmation_the_overlay_does_not_begin() -> None:
    session = ControllerSession(SessionTimes(monitor=0.0))
    for cycle in range(1000):
        session.update(1e-3 * cycle, Circumstances(Quality.EXCELLENT, confirmed=9))
    assert session.state is ASKED


def test_quality_rises_as_the_window_fills_and_falls_with_misses() -> None:
    quality = ConnectionQuality(QualityModel(), interval=0.01)
    levels = [quality.level]
    for _ in range(100):
        quality.count(answered=True)
        levels.append(quality.level)
    assert [levels.index(level) for level in Quality] == [0, 50, 80, 98]
    for _ in range(3):
        quality.count(answered=False)
    assert quality.level is Quality.GOOD
    for _ in range(7):
        quality.count(answered=False)
    assert quality.level is Quality.POOR  # ten in a row, though 90 % were answered
    quality.count(answered=True)
    assert quality.level is Quality.GOOD


@pytest.mark.parametrize(("period", "intervals"), [(1e-3, 100), (0.02, 50), (0.1, 10), (0.5, 10)])
def test_the_window_is_a_second_within_bounds(period: float, intervals: int) -> None:
    assert QualityModel().intervals(period) == intervals


def test_thresholds_have_to_rise() -> None:
    with pytest.raises(ConfigError, match="have to rise"):
        QualityModel(fair=0.9, good=0.8)


def fate(seed: int, disturbance: Disturbance, count: int = 1000) -> list[int]:
    channel = Channel("to_client", seed)
    came: list[int] = []
    for number in range(count):
        channel.put(number.to_bytes(2, "little"), number * 1000, disturbance)
        came += [int.from_bytes(d.data, "little") for d in channel.take(number * 1000)]
    return came + [int.from_bytes(d.data, "little") for d in channel.take(10**12)]


def test_an_undisturbed_link_passes_everything_in_order() -> None:
    assert fate(1, UNDISTURBED) == list(range(1000))


def test_fates_depend_on_the_seed_alone() -> None:
    bad = Disturbance(loss=0.2, delay=2e-6, jitter=5e-6, reorder=0.1, duplicate=0.1)
    assert fate(1, bad) == fate(1, bad)
    assert fate(1, bad) != fate(2, bad)


def test_what_a_disturbance_does() -> None:
    lossy = fate(3, Disturbance(loss=0.2))
    assert 700 < len(lossy) < 900
    assert lossy == sorted(lossy)
    assert fate(3, Disturbance(loss=1.0)) == []
    twice = fate(3, Disturbance(duplicate=0.3))
    assert len(twice) > 1200
    assert set(twice) == set(range(1000))
    overtaken = fate(3, Disturbance(reorder=0.3))
    assert overtaken != sorted(overtaken)
    assert all(abs(place - number) <= 1 for place, number in enumerate(overtaken))


def test_a_delayed_datagram_comes_when_it_is_due() -> None:
    channel = Channel("to_robot", 0)
    channel.put(b"late", 1000, Disturbance(delay=1e-6))
    assert channel.next_ns() == 2000
    assert channel.take(1999) == []
    assert channel.take(2000) == [(b"late", 2000, True)]
    assert channel.empty


def write(folder: Path, text: str) -> Path:
    path = folder / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_scenario_is_read_with_all_its_events(tmp_path: Path) -> None:
    scenario = ControllerScenario.load(
        write(
            tmp_path,
            """
seed: 7
events:
  - {event: push, at: 3, for: 1, joint: 2, torque: -1e1}
  - {event: loss, at: 1, for: 1, fraction: 0.5, direction: to_robot}
  - {event: delay, at: 1.5, for: 1, delay: 2e-3, jitter: 0.001}
  - {event: quality, at: 4, for: 1, quality: fair}
  - {event: safety_stop, at: 5, for: 1, state: stop2}
  - {event: session, at: 6, for: 1, state: idle}
  - {event: silence, at: 7, for: 1}
  - {event: reorder, at: 8, for: 1, fraction: 1}
  - {event: duplicate, at: 8, for: 1, fraction: 1}
  - {event: motion, at: 9, for: 1, joint: 1, amplitude: 0.1}
  - {event: force, at: 9, for: 1, force: [0, 0, -12]}
""",
        )
    )
    assert scenario.seed == 7
    assert scenario.events[0] == SimulatedPush(at=3.0, duration=1.0, joint=2, torque=-10.0)
    assert scenario.events[1] == Loss(
        at=1.0, duration=1.0, fraction=0.5, direction=Direction.TO_ROBOT
    )
    assert scenario.events[2] == Delay(at=1.5, duration=1.0, delay=2e-3, jitter=1e-3)
    clock = ScenarioClock(scenario)
    assert clock.at(0.9).to_robot == UNDISTURBED
    at = clock.at(1.6)
    assert at.to_robot == Disturbance(loss=0.5, delay=2e-3, jitter=1e-3)
    assert at.to_client == Disturbance(delay=2e-3, jitter=1e-3)
    assert clock.at(2.0).to_robot == Disturbance(delay=2e-3, jitter=1e-3)
    assert clock.at(3.5).pushes[0].joint == 2
    assert clock.at(4.5).quality is Quality.FAIR
    assert clock.at(5.5).safety is SafetyState.STOP2
    assert clock.at(6.0).session is SessionState.IDLE
    assert clock.at(7.0).silent
    assert clock.at(8.5).to_client == Disturbance(reorder=1.0, duplicate=1.0)
    assert clock.at(9.5).motions[0].amplitude == 0.1
    assert clock.at(9.5).pushes == (FlangeForce(at=9.0, duration=1.0, force=(0.0, 0.0, -12.0)),)
    assert clock.at(99.0) == ScenarioClock(ControllerScenario()).at(0.0)


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("event: []", 1, "has no 'event'; it has events, seed, from"),
        ("seed: x", 1, "seed is 'x', expected a whole number"),
        ("events: 3", 1, "events is '3', expected a list of mappings"),
        ("from: here", 1, "from is 'here', expected one of start, commanding"),
        ("events:\n  - {at: 1}", 2, "lacks `event:`, one of loss"),
        ("events:\n  - {event: storm, at: 1, for: 1}", 2, "event is 'storm', expected one of loss"),
        ("events:\n  - {event: loss, at: 1, fraction: 1}", 2, "loss: lacks for"),
        ("events:\n  - {event: loss, at: 1, for: 1, part: 1}", 2, "loss: has no 'part'"),
        ("events:\n\n  - {event: loss, at: -1, for: 1, fraction: 1}", 3, "at is -1 s, expected"),
        ("events:\n  - {event: loss, at: 0, for: 1, fraction: 2}", 2, "fraction is 2, expected"),
        (
            "events:\n  - {event: push, at: 0, for: 1, joint: 8, torque: 1}",
            2,
            "joint is 8, expected",
        ),
        (
            "events:\n  - {event: force, at: 0, for: 1, force: [1, 2]}",
            2,
            "expected a list of 3 numbers",
        ),
        ("events:\n  - {event: quality, at: 0, for: 1, quality: bad}", 2, "one of poor, fair"),
        ("events: [", 1, "is no YAML"),
    ],
)
def test_a_mistake_is_told_with_its_line(
    tmp_path: Path, text: str, line: int, message: str
) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=r"scenario\.yaml") as caught:
        ControllerScenario.load(path)
    assert message in str(caught.value)
    assert caught.value.line == line or message == "is no YAML"


def test_a_scenario_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read"):
        ControllerScenario.load(tmp_path / "none.yaml")


def test_times_of_a_scenario_can_count_from_commanding(tmp_path) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text("from: commanding\nevents:\n  - {event: silence, at: 1, for: 1}\n")
    clock = ScenarioClock(ControllerScenario.load(path))
    assert not clock.at(1.5).silent
    clock.begin_commanding(10.0)
    clock.begin_commanding(11.0)  # it was lost, and came again
    assert [clock.at(time).silent for time in (10.9, 11.1, 11.9, 12.1)] == [
        False,
        True,
        True,
        False,
    ]
