"""Ripples and pushes, found in simulated recordings where they are and not where they are not."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from lanes import sampled
from scipy.signal import lfilter
from wandering import wander

from estimators.diagnosis.contact import ContactIn, Push, covered, pushes, wrench_of
from estimators.diagnosis.hypotheses.responses import response
from estimators.diagnosis.hypotheses.ripple import ripples
from estimators.diagnosis.residuals.noise import Noise
from estimators.diagnosis.residuals.observations import Observations
from limo_driver.physics import ExternalContact, Simulation, TorqueRipple
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from limo_driver.physics import Effect
    from limo_driver.types import FloatArray, Motion

RATE, DURATION = 200.0, 60.0
NOISE = 0.02  # [N m], RMS, most of it below 3 Hz
WINDOWS = ((20.0, 20.8), (40.0, 40.6))  # [s]
WRENCHES = ((20.0, -10.0, 15.0, 0.0, 1.0, 0.0), (-10.0, 20.0, 5.0, 1.0, 0.0, 0.0))


def half_sines() -> ExternalContact:
    """Push as people do; made of pieces shorter than the filter can tell."""
    windows: list[tuple[float, float]] = []
    wrenches: list[tuple[float, ...]] = []
    for (start, end), wrench in zip(WINDOWS, WRENCHES, strict=True):
        edges = np.linspace(start, end, 41)
        windows += list(pairwise(edges.tolist()))
        course = np.sin(np.pi * (np.arange(40) + 0.5) / 40)
        wrenches += [tuple(size * np.array(wrench)) for size in course]
    return ExternalContact(windows=tuple(windows), wrench=tuple(wrenches))


def motion(seed: int) -> Motion:
    """All seven joints wander over about 2 rad, none at the pace of another."""
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    return wander(t, np.zeros(7), seed, (0.03, 0.12), (0.2, 0.5))


def observed(*effects: Effect, seeds: tuple[int, ...] = (1,), affected: int = 0) -> Observations:
    """Record motion with coloured noise; the effects act in one recording alone."""
    simulation = Simulation("iiwa14")
    recordings: list[Recording] = []
    for k, seed in enumerate(seeds):
        true = Simulation("iiwa14", effects) if k == affected else simulation
        moved = motion(seed)
        white = np.random.default_rng(100 + seed).standard_normal((len(moved), 7))
        coloured = lfilter([1.0], [1.0, -0.9], white, axis=0)
        torque = true.predict(moved) + NOISE * coloured / coloured.std()
        recordings.append(Recording.from_arrays(moved.time, moved.position, torque, source=str(k)))
    return Observations.of(simulation, recordings, 10.0)


def noise_of(o: Observations, residual: FloatArray) -> Noise:
    return Noise.of(residual, o.moving, o.segment)


def test_a_ripple_is_found_at_its_joint_with_its_cycles() -> None:
    true = TorqueRipple(joint=4, cycles_per_rev=(37.3,), amplitude=(0.03,), phase=(0.7,))
    o = observed(true)

    found = ripples(o, o.residual)

    assert [(found[0].effect, found[0].joints)] == [("torque_ripple", (3,))]
    assert found[0].settings == pytest.approx((37.3,), abs=0.1)


@sampled("periods", [1.8, 3.0, 5.0], "fits many sines, for seconds")
def test_a_ripple_of_few_periods_over_the_range_is_offered(periods: float) -> None:
    cycles = periods * 2 * np.pi / np.ptp(motion(1).position[:, 3])
    o = observed(TorqueRipple(joint=4, cycles_per_rev=(cycles,), amplitude=(0.06,), phase=(0.7,)))

    offered = [line for h in ripples(o, o.residual) if h.joints == (3,) for line in h.settings]

    assert min(abs(line - cycles) for line in offered) < 0.3


def test_harmonics_are_offered_together() -> None:
    true = TorqueRipple(joint=2, cycles_per_rev=(20, 40), amplitude=(0.06, 0.03), phase=(0.0, 1.0))
    o = observed(true)

    *_, both = ripples(o, o.residual)

    assert sorted(both.settings) == pytest.approx([20, 40], abs=0.15)
    assert len(both.terms) == 4


def test_all_lines_of_a_motor_are_found() -> None:
    """Pole pairs, slots, and what they have in common."""
    cycles, amplitude = (28, 48, 56, 84, 112, 144), (0.2, 0.06, 0.08, 0.13, 0.07, 0.05)
    o = observed(
        TorqueRipple(joint=2, cycles_per_rev=cycles, amplitude=amplitude, phase=(0.5,) * 6)
    )

    found = max((h.settings for h in ripples(o, o.residual)), key=len)

    resolution = 2 * np.pi / np.ptp(motion(1).position[:, 1])  # [1/rev]
    assert [N for N in cycles if min(abs(line - N) for line in found) > 0.3 * resolution] == []


def test_lines_are_found_beside_those_that_are_known() -> None:
    true = TorqueRipple(joint=2, cycles_per_rev=(40.0,), amplitude=(0.05,), phase=(1.0,))
    o = observed(true)

    found = ripples(o, o.residual, {1: (20.0,)})

    assert found
    assert all(h.settings[0] == 20.0 for h in found if h.joints == (1,))
    assert any(abs(line - 40.0) < 0.15 for h in found for line in h.settings)


def test_a_ripple_realises_as_the_sum_of_its_terms() -> None:
    o = observed(TorqueRipple(joint=2, cycles_per_rev=(20,), amplitude=(0.06,), phase=(0.4,)))
    (found,) = ripples(o, o.residual)
    c = np.array([0.05, -0.02])

    (effect,) = found.realise(c)

    parts = [response(term, o).values for term in found.terms]
    assert response(effect, o).values == pytest.approx(c[0] * parts[0] + c[1] * parts[1])


@sampled("seed", range(4), "more draws of noise, seconds each")
def test_nothing_is_found_in_coloured_noise(seed: int) -> None:
    o = observed(seeds=(seed, seed + 50))

    assert ripples(o, o.residual) == []
    assert pushes(o, o.residual, noise_of(o, o.residual)) == ()


def test_a_ripple_is_no_push_and_rows_without_pushes_have_no_ripple() -> None:
    shaken = observed(TorqueRipple(joint=4, cycles_per_rev=(37,), amplitude=(0.1,), phase=(0.0,)))
    pushed = observed(half_sines())

    assert pushes(shaken, shaken.residual, noise_of(shaken, shaken.residual)) == ()
    found = pushes(pushed, pushed.residual, noise_of(pushed, pushed.residual))
    rest = replace(pushed, disturbed=covered(pushed, found))
    assert ripples(rest, pushed.residual) == []


def test_a_push_is_found_in_its_recording_and_its_seconds() -> None:
    o = observed(half_sines(), seeds=(1, 2), affected=1)

    found = sorted(pushes(o, o.residual, noise_of(o, o.residual)), key=lambda push: push.start)

    assert [push.recording for push in found] == [1, 1]
    for push, (start, end) in zip(found, WINDOWS, strict=True):
        assert push.start == pytest.approx(start, abs=0.05)
        assert push.end == pytest.approx(end, abs=0.05)
    rows = covered(o, found)
    assert 0.005 < rows.mean() < 0.05
    assert not rows[o.recording == 0].any()


def test_the_column_of_a_push_is_what_the_contact_adds_there_and_nothing_elsewhere() -> None:
    o = observed(seeds=(1, 2))
    window, wrench = (WINDOWS[0],), (WRENCHES[0],)
    everywhere = response(ExternalContact(windows=window, wrench=wrench), o).values

    own = response(ContactIn(windows=window, wrench=wrench, recording=1), o).values

    there = o.recording == 1
    assert own[:, there] == pytest.approx(everywhere[:, there], abs=0.02)  # of 15 N m
    assert not own[:, ~there].any()


def test_what_one_joint_does_alone_is_no_push() -> None:
    o = observed()
    residual = o.residual.copy()
    time = o.slow.time
    residual[(time > 20) & (time < 20.8), 3] += 0.5

    assert pushes(o, residual, noise_of(o, o.residual)) == ()


def test_a_wrench_is_made_of_unit_half_sines() -> None:
    units = wrench_of(Push(0, 2.0, 3.0, 1.0))

    for axis, unit in enumerate(units):
        assert isinstance(unit, ExternalContact)
        assert (unit.windows[0][0], unit.windows[-1][1]) == pytest.approx((2.0, 3.0))
        course = np.array(unit.wrench)
        assert course[:, axis].max() == pytest.approx(1.0, abs=0.02)
        assert not np.delete(course, axis, axis=1).any()


def test_half_a_second_of_motion_has_no_pushes() -> None:
    o = observed()
    still = Noise.of(np.zeros_like(o.residual), o.moving, o.segment)

    assert pushes(o, np.zeros_like(o.residual), still) == ()
    assert covered(o, [Push(0, 1.0, 2.0, 1.0)]).sum() == pytest.approx(1.6 * 25, abs=2)
