"""Ripples and pushes, found in simulated recordings where they are and not where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from noisy_recordings import half_sines, motion, observed

from estimators.diagnosis.from_torque.hypotheses.catalogue import recorded_in
from estimators.diagnosis.from_torque.hypotheses.responses import response
from estimators.diagnosis.from_torque.hypotheses.ripple import (
    Spectrum,
    _peaks,
    ripples,
    with_fewer_lines,
)
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.pushes import covered, pushes
from limo_driver.physics import Simulation, TorqueOffset, TorqueRipple
from limo_driver.recordings.recording import Recording
from limo_driver.types.motion import Motion


def test_a_ripple_is_found_at_its_joint_with_its_cycles() -> None:
    true = TorqueRipple(joint=4, cycles_per_rev=(37.3,), amplitude=(0.03,), phase=(0.7,))
    o = observed(true)

    found = ripples(o, o.residual)

    assert [(found[0].effect, found[0].joints)] == [("torque_ripple", (3,))]
    assert found[0].settings == pytest.approx((37.3,), abs=0.1)


def at_places(arm, torque):
    """Record an arm of two joints at five places, far apart beside what is passed through there."""
    simulation, recordings = Simulation(str(arm)), []
    for k, moved in enumerate(motion(seed, 2, 20.0) for seed in range(5)):
        q, v, a = (0.05 * x for x in (moved.position, moved.velocity, moved.acceleration))
        measured = simulation.predict(Motion(moved.time, 0.3 * k + q, v, a))
        measured += 0.02 * np.random.default_rng(k).standard_normal(q.shape)
        measured[:, 0] += torque(k, q[:, 0])
        recordings.append(Recording.from_arrays(moved.time, 0.3 * k + q, measured, source=str(k)))
    return Observations.of(simulation, recordings, 10.0)


def test_what_places_have_of_their_own_is_no_ripple_but_lines_seen_at_each_are(arm):
    own = np.random.default_rng(1).uniform(-0.4, 0.4, (5, 2))
    curved = at_places(arm, lambda k, q: own[k, 0] + own[k, 1] * (q / 0.05) ** 2)
    lined = at_places(arm, lambda k, q: 0.3 * np.sin(300.0 * (0.3 * k + q)))

    offered = [h.settings for h in ripples(curved, curved.residual) if h.joints == (0,)]
    found = [h.settings for h in ripples(lined, lined.residual) if h.joints == (0,)]

    assert offered == []
    assert found == [pytest.approx((300.0,), abs=1.0)]


def test_of_lines_that_a_range_does_not_resolve_each_is_offered_alone() -> None:
    o = observed()
    apart = 2 * np.pi / np.ptp(o.slow.position[:, 1])
    near = (12.0, 12.0 + 0.4 * apart, 12.0 + 0.9 * apart)
    found = TorqueRipple.of_lines(2, (*near, 40.0))

    fewer = [hypothesis.settings for hypothesis in with_fewer_lines(found, o)]

    assert fewer == [(N, 40.0) for N in near]
    assert not list(with_fewer_lines(TorqueRipple.of_lines(2, (12.0, 40.0)), o))
    (other, *_) = TorqueOffset.at_joint(2, recorded_in(o))
    assert not list(with_fewer_lines(other, o))


@pytest.mark.slow("fits many sines, for seconds")
@pytest.mark.parametrize("periods", [1.8, 3.0, 5.0])
def test_a_ripple_of_few_periods_over_the_range_is_offered(periods: float) -> None:
    cycles = periods * 2 * np.pi / np.ptp(motion(1).position[:, 3])
    o = observed(TorqueRipple(joint=4, cycles_per_rev=(cycles,), amplitude=(0.06,), phase=(0.7,)))

    offered = [line for h in ripples(o, o.residual) if h.joints == (3,) for line in h.settings]

    assert min(abs(line - cycles) for line in offered) < 0.3


@pytest.mark.slow("fits many sines, for seconds")
def test_harmonics_are_offered_together() -> None:
    true = TorqueRipple(joint=2, cycles_per_rev=(20, 40), amplitude=(0.06, 0.03), phase=(0.0, 1.0))
    o = observed(true)

    *_, both = ripples(o, o.residual)

    assert sorted(both.settings) == pytest.approx([20, 40], abs=0.15)
    assert len(both.terms) == 4


@pytest.mark.slow("fits many sines, for seconds")
def test_all_lines_of_a_motor_are_found() -> None:
    """Pole pairs, slots, and what they have in common."""
    cycles, amplitude = (28, 48, 56, 84, 112, 144), (0.2, 0.06, 0.08, 0.13, 0.07, 0.05)
    o = observed(
        TorqueRipple(joint=2, cycles_per_rev=cycles, amplitude=amplitude, phase=(0.5,) * 6)
    )

    found = max((h.settings for h in ripples(o, o.residual)), key=len)

    resolution = 2 * np.pi / np.ptp(motion(1).position[:, 1])  # [1/rev]
    assert [N for N in cycles if min(abs(line - N) for line in found) > 0.3 * resolution] == []


@pytest.mark.slow("fits many sines, for seconds")
def test_lines_that_overlap_are_found_and_no_others() -> None:
    """A line blurs its neighbours, and what is left of itself then looks like more of them."""
    cycles = (20.0, 24.0, 28.0, 56.0, 60.0)
    amplitude = (0.4, 0.12, 0.16, 0.26, 0.14)
    o = observed(
        TorqueRipple(joint=2, cycles_per_rev=cycles, amplitude=amplitude, phase=(0.5,) * 5)
    )

    found = max((h.settings for h in ripples(o, o.residual) if h.joints == (1,)), key=len)

    resolution = 2 * np.pi / np.ptp(motion(1).position[:, 1])  # [1/rev]
    assert sorted(found) == pytest.approx(cycles, abs=resolution)


@pytest.mark.slow("fits many sines, for seconds")
def test_lines_are_found_beside_those_that_are_known() -> None:
    true = TorqueRipple(joint=2, cycles_per_rev=(40.0,), amplitude=(0.05,), phase=(1.0,))
    o = observed(true)

    found = ripples(o, o.residual, {1: (20.0,)})

    assert found
    assert all(h.settings[0] == 20.0 for h in found if h.joints == (1,))
    assert any(abs(line - 40.0) < 0.15 for h in found for line in h.settings)


@pytest.mark.slow("fits many sines, for seconds")
def test_a_ripple_realises_as_the_sum_of_its_terms() -> None:
    o = observed(TorqueRipple(joint=2, cycles_per_rev=(20,), amplitude=(0.06,), phase=(0.4,)))
    (found,) = ripples(o, o.residual)
    c = np.array([0.05, -0.02])

    (effect,) = found.realise(c)

    parts = [response(term, o).values for term in found.terms]
    assert response(effect, o).values == pytest.approx(c[0] * parts[0] + c[1] * parts[1])


@pytest.mark.slow("fits many sines, for seconds")
@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_found_in_coloured_noise(seed: int) -> None:
    o = observed(seeds=(seed, seed + 50))

    assert ripples(o, o.residual) == []
    assert pushes(o, o.residual) == ()


@pytest.mark.slow("fits many sines, for seconds")
def test_a_ripple_is_no_push_and_rows_without_pushes_have_no_ripple() -> None:
    shaken = observed(TorqueRipple(joint=4, cycles_per_rev=(37,), amplitude=(0.1,), phase=(0.0,)))
    pushed = observed(half_sines())

    assert pushes(shaken, shaken.residual) == ()
    found = pushes(pushed, pushed.residual)
    rest = replace(pushed, disturbed=covered(pushed, found))
    assert ripples(rest, pushed.residual) == []


def test_the_next_highest_peaks_are_tried_and_not_the_flanks_of_the_first() -> None:
    cycles = np.arange(0.0, 200.0, 0.25)
    amount = np.ones(cycles.size)
    amount[200:203], amount[240], amount[300] = (20.0, 30.0, 20.0), 15.0, 10.0
    spectrum = Spectrum(cycles, amount, np.ones(cycles.size))

    alone, beside = list(_peaks(spectrum, ())), list(_peaks(spectrum, (61.0,)))

    assert alone[:3] == [cycles[201], cycles[240], cycles[300]]
    assert beside[:2] == [
        cycles[201],
        cycles[300],
    ]  # what a line may leave of itself is passed over
    assert len(set(alone)) == len(alone)
