"""Jolts: found where errors of several joints are far larger than usual at once, and seldom."""

from __future__ import annotations

import numpy as np
import pytest
from noisy_recordings import half_sines, observed

from estimators.diagnosis.from_torque.residuals.jolts import Jolt, jolts
from estimators.diagnosis.from_torque.residuals.jolts import jolts_note as note
from estimators.diagnosis.from_torque.residuals.pushes import covered, pushes
from estimators.diagnosis.from_torque.residuals.reversals import steadily_moving
from estimators.diagnosis.settings import OUTLYING
from estimators.diagnosis.settings.judgement import WORDING


def rung(residual, time, at, joints, size=1.0):
    """Return errors (K, n) with a ring of 8 Hz that fades within 0.2 s [N m]."""
    since = np.maximum(time - at, 0.0)
    ring = size * np.sin(2 * np.pi * 8.0 * since + 0.5) * np.exp(-since / 0.1) * (time >= at)
    result = residual.copy()
    result[:, list(joints)] += ring[:, None]
    return result


def test_an_arm_that_rings_is_jolted_there_and_nowhere_else() -> None:
    o = observed()
    time = o.slow.time
    steady = [at for at in np.arange(5.0, 50.0, 0.5) if len(jolted(o, at)) == 1]

    assert len(steady) > 10  # at the others, joints turn
    (found,) = jolted(o, steady[0])

    assert found.recording == 0
    assert steady[0] <= found.start <= found.end < steady[0] + 0.4
    assert {*found.joints} <= {1, 3, 4}
    assert found.times > OUTLYING
    rows = covered(o, (found,))
    assert rows[np.abs(time - steady[0]) < 0.1].all()
    assert rows.mean() < 0.03


def jolted(o, at):
    return jolts(o, rung(o.residual, o.slow.time, at, (1, 3, 4)), ())


def test_what_one_joint_alone_does_is_none() -> None:
    o = observed()
    for at in np.arange(5.0, 50.0, 5.0):
        assert jolts(o, rung(o.residual, o.slow.time, at, (3,)), ()) == ()


def test_joints_that_turn_do_not_count() -> None:
    o = observed()
    time, turns = o.slow.time, ~steadily_moving(o)[:, [1, 3]].all(axis=1)
    starts = np.arange(5.0, 50.0, 0.2)
    some = [at for at in starts if turns[(time > at - 0.1) & (time < at + 0.4)].all()]
    assert some
    for at in some:
        assert jolts(o, rung(o.residual, time, at, (1, 3)), ()) == ()


def test_noise_holds_none() -> None:
    o = observed(seeds=(1, 2))
    assert jolts(o, o.residual, ()) == ()


def test_what_recurs_is_none() -> None:
    o = observed()
    residual = o.residual
    for at in np.arange(3.0, 55.0, 1.0):
        residual = rung(residual, o.slow.time, at, (1, 3, 4))
    assert jolts(o, residual, ()) == ()


def test_a_push_is_none_besides() -> None:
    o = observed(half_sines(), seeds=(1, 2), affected=1)
    assert jolts(o, o.residual, ())
    assert jolts(o, o.residual, pushes(o, o.residual)) == ()


@pytest.mark.parametrize(
    ("recordings", "when"),
    [(1, "At 3.2 s and 9.0 s"), (2, "At 3.2 s of recording 1 and at 9.0 s of recording 2")],
)
def test_a_note_says_when_where_and_how_far(recordings, when) -> None:
    found = (Jolt(0, 3.21, 3.4, (1, 2), 16.2), Jolt(recordings - 1, 9.0, 9.1, (0, 2), 7.0))
    said = note(found, recordings)
    assert said.startswith(f"{when} the errors")
    assert "joints 1, 2 and 3 are up to 16 times" in said


def test_a_note_names_the_recording_once_and_counts_what_it_does_not_name() -> None:
    many = [Jolt(1, float(at), at + 0.1, (0, 1), 6.0) for at in range(WORDING.listed + 2)]
    said = note([Jolt(0, 7.0, 7.1, (0, 1), 6.0), *many[:-1]], 2)
    assert said.startswith("At 7.0 s of recording 1 and at 0.0 s, 1.0 s, ")
    assert f"{WORDING.listed - 1:.1f} s and 1 other time of recording 2 the errors" in said
    assert "and 2 other times the errors" in note(many, 1)
