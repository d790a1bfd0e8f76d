"""Impacts: told from pushes by the column of the mass matrix along which they err."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
from noisy_recordings import half_sines, observed

from estimators.diagnosis.from_torque.events import Events
from estimators.diagnosis.from_torque.residuals.jolts import Impact, impacts
from estimators.diagnosis.from_torque.residuals.jolts import impacts_note as note
from estimators.diagnosis.from_torque.residuals.pushes import Push, pushes

if TYPE_CHECKING:
    from estimators.diagnosis.from_torque.residuals.observations import Observations


def changes(o, joint: int) -> list[float]:
    """Return when the load of a joint (0-based) changes sign in the middle of the motion [s]."""
    time, load = o.slow.time, o.load[o.kept][:, joint]
    at = time[1:][np.diff(np.sign(load)) != 0]
    return [float(t) for t in at if 5.0 < t < 55.0]


def caught(o, joint: int, at: list[float]):
    """Return errors (K, n) of a joint's link that is caught for a tenth of a second [N m]."""
    pulse = sum(np.exp(-0.5 * ((o.slow.time - t) / 0.05) ** 2) for t in at)
    return o.residual + 5.0 * (o.inertia[joint] * pulse).T


def events(at: list[float]) -> tuple[Push, ...]:
    return tuple(Push(0, t - 0.1, t + 0.1, 200.0, (0, 1)) for t in at)


def test_a_link_that_is_caught_soon_after_its_load_has_changed_is_an_impact() -> None:
    o = observed()
    at = [t + 0.2 for t in changes(o, 1)[:2]]
    assert len(at) == 2

    found = impacts(o, caught(o, 1, at), events(at))

    assert [(impact.start, impact.end) for impact in found] == [(t - 0.1, t + 0.1) for t in at]
    assert all(impact.joint == 1 for impact in found)


def test_what_is_seen_once_or_far_from_a_change_of_the_load_is_none() -> None:
    o = observed()
    at = [t + 0.2 for t in changes(o, 1)[:2]]
    assert impacts(o, caught(o, 1, at[:1]), events(at[:1])) == ()

    time, load = o.slow.time, o.load[o.kept][:, 1]
    same = [np.ptp(np.sign(load[(time > t - 1.7) & (time < t + 0.3)])) == 0 for t in time]
    inside = time[np.array(same) & (time > 5.0) & (time < 55.0)]
    away = [float(inside[0]), float(inside[-1])]
    assert impacts(o, caught(o, 1, away), events(away)) == ()


def test_fewer_joints_than_three_make_no_ratios_to_go_by() -> None:
    o = observed()
    at = [t + 0.2 for t in changes(o, 1)[:2]]
    errors = caught(o, 1, at)
    assert impacts(o, errors, events(at))
    two = cast("Observations", SimpleNamespace(n=2))
    assert impacts(two, errors[:, :2], events(at)) == ()


def test_somebody_who_pushes_makes_none() -> None:
    o = observed(half_sines())
    found = pushes(o, o.residual)

    assert len(found) == 2
    assert impacts(o, o.residual, found) == ()


def test_the_note_says_when_and_which_joint_may_have_play() -> None:
    found = (Impact(1, 4.0, 4.2, 1), Impact(0, 9.0, 9.2, 3))

    said = note(found, recordings=2)

    assert "At 9.0 s of recording 1 and at 4.0 s of recording 2" in said
    assert "of joint 2 or 4 alone" in said
    assert list(Events(found, ()).notes(2)) == [said]
    assert Events(found, ()).pushes == ()
