"""A stream of every kind of model as C: equal to Python's, through starts, gaps and bad input."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from c_model import COMPILERS, CEstimates, CModel, worst
from lanes import sampled
from wandering import wander

from estimators.embedded.contact import measured_contact
from estimators.embedded.export import export_c
from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.joint_physics import JointPhysics
from estimators.stream import LiveEstimate, Stream
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from estimators.base import LiveEstimator
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

RATE = 200.0
NETWORKS = [
    ("mlp7", "drive"),
    ("lstm-fcl", "own-joint"),
    ("lstm-2", "all-joints"),
    ("gru", "own-joint"),
    ("lru", "drive"),
]
SINGLE = 3e-7  # of the leverage: inputs apart by 1e-13 may round to different floats
OK, NOT_FINITE, TIME_STOOD, TORQUE_CHANGED = range(4)


@pytest.fixture(scope="module")
def moved(true_arm: Simulation) -> Recording:
    """A minute of motion, some samples lost, two gaps, one of them short; torque with noise."""
    t = np.arange(int(60 * RATE)) / RATE
    lost = np.isin(np.arange(t.size) % 400, [50, 51, 230])
    t[t.size // 2 :] += 0.7
    t[t.size // 3 :] += 0.15
    motion = wander(t, np.array([0.3, -0.8]), 5, (0.1, 0.9), (0.01, 0.3))
    torque = true_arm.predict(motion)
    torque += np.random.default_rng(0).normal(0.0, 0.02, torque.shape)
    return Recording.from_arrays(t[~lost], motion.position[~lost], torque[~lost])


@pytest.fixture(scope="module")
def physics(rigid: Simulation, record: Callable[[int, float], Recording]) -> JointPhysics:
    return JointPhysics(rigid).fit([record(0, 40.0)])


@pytest.fixture(scope="module")
def built_rigid(rigid: Simulation, tmp_path_factory: pytest.TempPathFactory) -> CModel:
    return CModel.of(rigid, tmp_path_factory.mktemp("rigid"), RATE)


@pytest.fixture(scope="module", params=COMPILERS)
def built_physics(
    physics: JointPhysics,
    tmp_path_factory: pytest.TempPathFactory,
    request: pytest.FixtureRequest,
) -> CModel:
    return CModel.of(physics, tmp_path_factory.mktemp("physics"), RATE, request.param)


def network(kind: str, features: str, rigid: Simulation, learned_from: Recording) -> HybridModel:
    settings = TrainingSettings(
        model=kind, features=features, epochs=1, sequence_length=20, rate=50.0, hidden=6, folds=2
    )
    return HybridModel(rigid, settings).fit([learned_from])


def faded(model: LiveEstimator | Simulation, late: LiveEstimate) -> FloatArray:
    """Return how much joint physics takes back of what it learned, at most, (T, n) [N m]."""
    if not isinstance(model, JointPhysics):
        return np.zeros_like(late.torque)
    known = model.fitted.calibration
    leverage = (late.std**2 - known.certain) / known.unsure
    once, twice = known.fading
    return np.abs(late.learned) * (once + twice * leverage) * leverage


def compare(model: LiveEstimator | Simulation, found: CEstimates, moved: Recording) -> None:
    stream = Stream(model, RATE)
    late, _ = stream.advance(stream.init(), moved.time, moved.position, moved.torque)
    assert late.measured is not None
    assert (found.status == OK).all()
    np.testing.assert_allclose(found.time, late.time, rtol=0, atol=1e-12)
    difference, scale = np.abs(found["torque"] - late.torque), np.abs(late.torque).max()
    assert (difference <= 1e-9 * scale + SINGLE * faded(model, late)).all()
    assert worst(found["simulation"], late.simulation) < 1e-9
    assert worst(found["measured"], late.measured) < 1e-9
    np.testing.assert_array_equal(found["external"], found["measured"] - found["torque"])
    np.testing.assert_allclose(found["deviation"], late.std, rtol=SINGLE, equal_nan=True)
    np.testing.assert_array_equal(found["outside"] > 0, late.outside)


@pytest.mark.slow("learns, and runs a minute of motion")
def test_joint_physics_equals_its_stream(
    physics: JointPhysics, built_physics: CModel, moved: Recording
) -> None:
    compare(physics, built_physics.stream(moved.time, moved.position, moved.torque), moved)


@sampled(
    ("kind", "features"), NETWORKS, "trains and compiles each", ids=[kind for kind, _ in NETWORKS]
)
def test_networks_equal_their_streams(
    kind: str,
    features: str,
    rigid: Simulation,
    moved: Recording,
    record: Callable[[int, float], Recording],
    tmp_path: Path,
) -> None:
    model = network(kind, features, rigid, record(0, 30.0))
    built = CModel.of(model, tmp_path, RATE)
    compare(model, built.stream(moved.time, moved.position, moved.torque), moved)


def test_a_bare_simulation_equals_its_stream_and_rests(
    rigid: Simulation, built_rigid: CModel, moved: Recording
) -> None:
    """And it rests where its stream does: with an encoder's noise, through a gap and a start."""
    position = np.array(moved.position)
    position[5000:7000] = position[5000]
    position += np.random.default_rng(1).normal(0.0, 1e-5, position.shape)
    moved = replace(moved, position=position)
    stream = Stream(rigid, RATE)
    values, _ = stream.differentiator.filter(
        stream.init().signals, moved.time[:7000], position[:7000]
    )
    assert np.mean(values[1, 5100:] == 0.0) > 0.98
    assert stream.smoother is not None
    found = built_rigid.stream(moved.time, moved.position, moved.torque)
    compare(rigid, found, moved)
    friction = found["friction"][6200:7000]  # the gap is over
    assert np.abs(friction).max() < 1e-3  # of 1 N m


@pytest.mark.slow("learns, and runs a minute of motion")
def test_without_torque_there_is_no_external_one(
    physics: JointPhysics, built_physics: CModel, moved: Recording
) -> None:
    found = built_physics.stream(moved.time, moved.position)
    late = Stream(physics, RATE).predict(moved)
    assert worst(found["torque"], late) < SINGLE
    assert np.isnan(found["external"]).all()


def test_bad_input_is_refused_and_changes_nothing(built_rigid: CModel, moved: Recording) -> None:
    time, position, torque = moved.time[:300], moved.position[:300], moved.torque[:300]
    undisturbed = built_rigid.stream(time, position, torque)
    bad = {100: NOT_FINITE, 150: TIME_STOOD, 200: NOT_FINITE, 250: NOT_FINITE}
    rows = np.sort(np.concatenate([np.arange(300), list(bad)]))
    at = {int(np.flatnonzero(rows == row)[1]): status for row, status in bad.items()}
    time, position, torque = time[rows], position[rows].copy(), torque[rows].copy()
    first, _, third, fourth = at
    position[first, 1], torque[third, 0] = np.inf, np.nan
    position[fourth, 1] = 1e200  # squares of its derivatives overflow
    found = built_rigid.stream(time, position, torque)
    assert {int(t): int(found.status[t]) for t in np.flatnonzero(found.status)} == at
    good = found.status == OK
    np.testing.assert_array_equal(found["torque"][good], undisturbed["torque"])


def test_a_wild_time_costs_a_start_and_not_all_that_follow(
    rigid: Simulation, built_rigid: CModel, moved: Recording
) -> None:
    time, position, torque = moved.time[:400].copy(), moved.position[:400], moved.torque[:400]
    time[200] = 1e9  # far ahead, so that each later one is far back
    time[300] -= 1.0  # far back, and the next far ahead
    found = built_rigid.stream(time, position, torque)
    stream = Stream(rigid, RATE)
    late, _ = stream.advance(stream.init(), time, position, torque)
    assert (found.status == OK).all()
    assert worst(found["simulation"], late.simulation) < 1e-9
    anew, _ = stream.advance(stream.init(), time[301:], position[301:], torque[301:])
    np.testing.assert_array_equal(late.torque[301:], anew.torque)


def alarms(found: CEstimates) -> int:
    """Return how often a contact began; what is within 0.1 s is one."""
    begun = np.flatnonzero(np.diff((found["contact"] > 0.0).any(axis=1).astype(int)) > 0)
    return int(np.count_nonzero(np.diff(begun, prepend=-100) > 10))


PUSHED: list[object] = ["rigid", pytest.param("physics", marks=pytest.mark.slow("learns"))]


@pytest.mark.parametrize("kind", PUSHED)
def test_a_push_is_a_contact_and_errors_are_as_rarely_one_as_stated(
    kind: str,
    record: Callable[[int, float], Recording],
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    """Sixty alarms an hour are one in the minute that is judged; four are within its chance."""
    model = request.getfixturevalue(kind)
    free = [record(seed, 60.0) for seed in (1, 2)]
    # the arm's recordings are at half the rate
    built = CModel.of(model, tmp_path, 100.0, false_alarms=60.0, free=free)
    header = (tmp_path / "limo.h").read_text()
    assert re.search(r"60 false alarms of contact an hour \(95 %: .*\), from \d+ s of free", header)
    assert "elbow: above" in header
    quiet = record(3, 60.0)
    assert alarms(built.stream(quiet.time, quiet.position, quiet.torque)) <= 4
    pushed, push = quiet.torque.copy(), (quiet.time > 12.0) & (quiet.time < 12.5)
    pushed[push, 1] += 6.0
    found = built.stream(quiet.time, quiet.position, pushed)
    during = (found.time > 12.1) & (found.time < 12.4) & (found["known"][:, 1] > 0.0)
    assert during.any()
    assert found["contact"][during, 1].all()
    still = quiet.position.copy()
    still[:, 1] = still[0, 1]  # how its friction stands is not known
    at_rest = built.stream(quiet.time, still, pushed)
    assert not at_rest["contact"][:, 1].any()
    assert not at_rest["known"][:, 1].any()
    for lost, goes_on in ((0.1, True), (0.3, False)):  # in the push; its memory is kept, or not
        kept = (quiet.time < 12.25) | (quiet.time > 12.25 + lost)
        gap = built.stream(quiet.time[kept], quiet.position[kept], pushed[kept])
        after = (gap.time > 12.26) & (gap.filled == 0.0)
        assert after.any()
        assert not gap["known"][after].any()
        assert (gap["contact"][after, 1] == goes_on).all()
    assert np.isfinite(found["threshold"]).all()
    # four times as fast as any free motion, with errors of its inertia: no contact, but not known
    rows = slice(None, None, 4)
    fast = built.stream(
        quiet.time[: quiet.time[rows].size], quiet.position[rows], quiet.torque[rows]
    )
    wrong = np.abs(fast["external"]) > fast["threshold"]
    assert wrong[fast.filled > 0.0].any()
    assert not (wrong & (fast["known"] > 0.0)).any()
    assert not fast["contact"].any()


def test_without_free_motion_no_code_of_contact_is_written(
    rigid: Simulation, tmp_path: Path
) -> None:
    written = export_c(rigid, tmp_path, RATE)
    assert "no contact, whose threshold takes free motion (--free RECORDING)" in str(written)
    assert "takes free motion (--free RECORDING)" in written.header.read_text()
    program = tmp_path / "asks.c"
    program.write_text('#include "limo.h"\nbool f(limo_estimate *e) { return e->contact[0]; }\n')
    done = subprocess.run(
        ["gcc", "-fsyntax-only", str(program)], capture_output=True, text=True, check=False
    )
    assert "no member named" in done.stderr
    with pytest.raises(ConfigError, match=r"5 false alarms an hour: .*--free RECORDING"):
        export_c(rigid, tmp_path, RATE, false_alarms=5.0)


def test_free_motion_that_says_too_little_is_refused(
    rigid: Simulation, record: Callable[[int, float], Recording]
) -> None:
    stream, calm = Stream(rigid, 100.0), record(4, 3.0)
    with pytest.raises(RecordingError, match=r"shoulder: few peaks .* 2\.8 s .* record some \d+ s"):
        measured_contact(1.0, stream, rigid, [calm])
    with pytest.raises(RecordingError, match=r"no error that counts in 0\.1 s"):
        measured_contact(1.0, stream, rigid, [calm[slice(0, 10)]])
    with pytest.raises(RecordingError, match="sampled at 100 Hz, expected 200 Hz"):
        measured_contact(1.0, Stream(rigid, 200.0), rigid, [calm])
    for wrong in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="false alarms an hour, expected more than 0"):
            measured_contact(wrong, stream, rigid, [calm])


def test_names_begin_as_told(rigid: Simulation, tmp_path: Path) -> None:
    for name in ("left", "right"):
        export_c(rigid, tmp_path, RATE, name=name)
    text = (tmp_path / "left.h").read_text() + (tmp_path / "left.c").read_text()
    assert "left_step" in text
    assert "limo_" not in text
    with pytest.raises(ConfigError, match="no name"):
        export_c(rigid, tmp_path, RATE, name="2 arms")
