"""A lag that hides behind what it makes late, on a joint that turns with a ripple."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from noisy_recordings import motion

from estimators.diagnosis import diagnose
from estimators.diagnosis.from_torque.fitting import lateness
from estimators.diagnosis.from_torque.fitting.lateness import long_after
from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.hypotheses.responses import response
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.stages import quiet
from limo_driver.physics import (
    CoulombFriction,
    Simulation,
    TimeDelay,
    Tolerances,
    TorqueGain,
    TorqueRipple,
    ViscousFriction,
)
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

RATE = 100.0  # [Hz]
RIPPLE = TorqueRipple(joint=1, cycles_per_rev=(7.0, 28.0), amplitude=(0.3, 0.2), phase=(0.4, -1.0))


def test_what_an_effect_adds_is_as_late_as_its_sensor() -> None:
    late = Simulation("iiwa14", (TimeDelay(joint=4, lag=0.1), TorqueGain(joint=4, gain=0.1)))
    ripple = TorqueRipple(joint=4, cycles_per_rev=(20.0,), amplitude=(0.5,), phase=(0.7,))
    moved = motion(1)
    recording = Recording.from_arrays(moved.time, moved.position, late.predict(moved))
    observed = Observations.of(late, [recording], 10.0)
    more = replace(late, effects=(ripple, *late.effects))
    added = observed.filter(observed.predict(more) - observed.predict(late))[:, 3]
    settled = observed.slow.time > 1.0  # ten lags after the first row

    found = response(ripple, observed)

    assert found.joints == (3,)
    # the gain scales it too, which a coefficient makes up for
    off = np.abs(1.1 * found.values[0] - added)[settled]
    assert off.max() < 0.02 * np.abs(added).max()


def turning(seed: int, seconds: float = 40.0, faster: float = 1.0) -> Motion:
    """One joint turns to and fro by two radians, at several speeds; the other rests."""
    random = np.random.default_rng(seed)
    t = np.arange(int(seconds * RATE)) / RATE
    w = 2 * np.pi * np.array([0.05, 0.09, 0.16]) * faster
    a, phase = np.array([1.0, 0.6, 0.35]) / faster**0.6, random.uniform(0, 2 * np.pi, 3)
    values = [
        np.column_stack(
            [(np.sin(np.outer(t, w) + phase + k * np.pi / 2) * a * w**k).sum(axis=1)] * 2
        )
        for k in range(3)
    ]
    values[0][:, 1] += 0.3
    return Motion(t, *values)


def with_friction(arm) -> Simulation:
    """Return what is stated of the arm."""
    friction = [
        effect
        for joint in (1, 2)
        for effect in (
            CoulombFriction(joint=joint, tau_c=0.2),
            ViscousFriction(joint=joint, f_v=0.1),
        )
    ]
    return Simulation(str(arm), tuple(friction), tolerances=Tolerances(inertia=0.005, friction=0.1))


def test_every_joint_may_be_late_by_much():
    tried = [(item.joints, item.law) for item in long_after(3)]
    laws = list(dict.fromkeys(law for _, law in tried))
    assert len(laws) == 2
    assert tried == [((joint,), law) for joint in range(3) for law in laws]


@pytest.mark.parametrize("most", [0.5, 50.0])  # [nat]
@pytest.mark.parametrize(
    ("begins", "long", "found"), [(0.0, False, True), (0.05, False, False), (0.05, True, True)]
)
def test_what_does_not_begin_to_help_is_tried_where_it_may_be_late_by_much(
    most, begins, long, found
):
    def fit(late):
        gain = most * (1.0 - abs(late.delay / 0.08 - 1.0)) if late.delay > begins else 0.0
        return gain, np.array([9.0, late.delay])

    alone = SimpleNamespace(joint=0, own=[1], place=[4, 7], fit=fit)
    best = lateness._latest(alone, None, TimeDelay(joint=1), long=long)
    assert (best is not None) is found
    if best is not None:
        assert (best.name, best.time, best.gain) == ("delay", 0.08, most)
        assert (best.changed, best.coefficients.tolist()) == ([7], [0.08])


@pytest.mark.parametrize(
    ("gains", "unknown", "late"),
    [((90.0, 50.0), (), 0), ((90.0, 50.0), (1,), 1), ((0.1, 0.1), (), None)],
)
def test_of_joints_that_are_late_the_unexplained_and_then_the_clearest_comes_first(
    arm, monkeypatch, gains, unknown, late
):
    moved = turning(1, 10.0)
    given = with_friction(arm)
    recording = Recording.from_arrays(moved.time, moved.position, given.predict(moved))
    problem = RegressionProblem.of(Observations.of(given, [recording], 10.0), quiet)
    beside = fitted(problem, (), Noise.independent(np.full(2, 0.01), problem.split.fitted))
    found = [lateness._Late(j, "lag", 0.02, gains[j], beside, [0], np.array([0.3])) for j in (0, 1)]
    monkeypatch.setattr(lateness, "_of_joint", lambda _solution, joint, **_: found[joint])
    made = lateness.with_torque_delay(beside, unknown)
    assert (made is None) == (late is None)
    if made is not None:
        (member,) = made.members
        assert made.problem.candidates[member].place == ("time_delay", (late,))
        assert made.fitted.mean[[0, -1]] == pytest.approx([0.3, 1.0])


@pytest.mark.slow("diagnoses two recordings, and looks for a delay where none seems to help")
def test_a_delay_of_half_a_period_is_named(arm) -> None:
    given = with_friction(arm)
    true = replace(given, effects=(*given.effects, TimeDelay(joint=1, delay=0.46)))
    recordings = []
    for seed in (1, 2):
        moved = turning(seed, faster=6.0)
        noise = 0.01 * np.random.default_rng(seed).standard_normal((len(moved), 2))
        recordings.append(
            Recording.from_arrays(moved.time, moved.position, true.predict(moved) + noise)
        )

    (found,) = diagnose(given, recordings).verdict.findings

    assert (found.effect, found.joints) == ("time_delay", (1,))
    assert found.parameters["delay"].value == pytest.approx(0.46, abs=0.002)


@pytest.mark.slow("diagnoses two recordings, around a lag once more")
@pytest.mark.parametrize("late", [TimeDelay(joint=1, lag=0.12), TimeDelay(joint=1, delay=0.08)])
def test_a_lag_behind_a_ripple_is_named_with_it_and_nothing_else(arm, late) -> None:
    given = with_friction(arm)
    true = replace(given, effects=(*given.effects, RIPPLE, late))
    recordings = []
    for seed in (1, 2):
        moved = turning(seed)
        noise = 0.01 * np.random.default_rng(seed).standard_normal((len(moved), 2))
        recordings.append(
            Recording.from_arrays(moved.time, moved.position, true.predict(moved) + noise)
        )

    found = diagnose(given, recordings)

    assert {(item.effect, item.joints) for item in found.verdict.findings} == {
        ("torque_ripple", (1,)),
        ("time_delay", (1,)),
    }
    delays = [effect for effect in found.after.effects if isinstance(effect, TimeDelay)]
    assert sum(effect.delay + effect.lag for effect in delays) == pytest.approx(
        late.delay + late.lag, rel=0.2
    )
