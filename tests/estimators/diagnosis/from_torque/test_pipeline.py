"""The diagnosis from end to end on simulated recordings in which one effect is concealed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lanes import sampled
from scipy.signal import lfilter
from threadpoolctl import threadpool_info, threadpool_limits

import limo_driver as limo
from estimators.diagnosis import diagnose
from estimators.diagnosis.from_torque import events, pipeline
from estimators.diagnosis.from_torque.fitting.problem import fitted
from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.pushes import Push
from estimators.diagnosis.from_torque.residuals.reversals import steadily_moving
from estimators.diagnosis.settings.residuals import HELD_OUT, ROWS
from estimators.diagnosis.verdict import UNKNOWN
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.physics import (
    Backlash,
    CoulombFriction,
    JointElasticity,
    Payload,
    PreslidingHysteresis,
    Simulation,
    SpringLoad,
    Tolerances,
    TorqueDrift,
    TorqueGain,
    ViscousFriction,
)
from limo_driver.physics.effects.friction import SIGN_WIDTH
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

RATE = 100.0  # [Hz]
MEMORY = 0.05  # [s], of the torque sensors' errors
NOISE = 0.03  # [N m], of the first joint; less towards the flange
HARMONICS = np.arange(1, 9)  # of 0.05 Hz
CLOSED = 1.2  # [noise floors] of held-out error that a right explanation may leave


def motion_of(simulation, seed, duration=60.0):
    """Return a Fourier motion within 0.6 of the position limits and 0.4 of the speeds."""
    random = np.random.default_rng(seed)
    t = np.arange(int(duration * RATE)) / RATE
    w = 2 * np.pi * 0.05 * HARMONICS
    limits = simulation.model.limits
    c, d = random.normal(size=(2, w.size, simulation.model.n)) / np.sqrt(HARMONICS)[:, None]
    sin, cos = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    position, velocity = sin @ c + cos @ d, (cos * w) @ c - (sin * w) @ d
    acceleration = -(sin * w**2) @ c - (cos * w**2) @ d
    scale = np.minimum(
        0.6 * limits.position_max / np.abs(position).max(axis=0),
        0.4 * limits.velocity / np.abs(velocity).max(axis=0),
    )
    return Motion(t, scale * position, scale * velocity, scale * acceleration)


def record(true, seed, duration=60.0):
    """Measure a motion with coloured noise and an encoder of 10 µrad."""
    motion = motion_of(true, seed, duration)
    random = np.random.default_rng(1000 + seed)
    a = np.exp(-1 / (RATE * MEMORY))
    drawn = np.sqrt(1 - a**2) * random.standard_normal(motion.position.shape)
    noise = NOISE / np.arange(1, motion.n + 1) * lfilter([1.0], [1.0, -a], drawn, axis=0)
    position = np.round(motion.position / 1e-5) * 1e-5
    return Recording.from_arrays(motion.time, position, true.predict(motion) + noise)


def names(diagnosis):
    return {(item.effect, item.kind, item.joints) for item in diagnosis.verdict.findings}


def closure(diagnosis):
    """Return the worst joint's held-out RMSE over its noise floor, before and after."""
    fit = diagnosis.verdict.fit
    floor = np.array(fit.noise_floor)
    before, after = fit.heldout_rmse_before, fit.heldout_rmse_after
    return np.max(before / floor), np.max(after / floor)


def error(simulation, truth, seed=77):
    """Return the worst joint's RMS error on another motion of the arm, while it moves [N m]."""
    recording = record(truth, seed)
    difference = truth.predict(recording) - simulation.predict(recording)
    moves = np.abs(recording.sharp_motion(10.0).velocity) > ROWS.rest * SIGN_WIDTH
    return float(np.sqrt(np.mean(difference**2, axis=0, where=moves)).max())


@pytest.fixture(scope="module")
def given(arm):
    """A two-joint arm that is known well."""
    return Simulation(
        str(arm),
        (
            CoulombFriction(joint=1, tau_c=1.0),
            CoulombFriction(joint=2, tau_c=0.6),
            ViscousFriction(joint=1, f_v=0.5),
            ViscousFriction(joint=2, f_v=0.3),
        ),
        tolerances=Tolerances(inertia=0.005, friction=0.15),
    )


PUSH = Push(recording=0, start=20.0, end=21.0, evidence=500.0, joints=tuple(range(7)))


def plus(simulation, effect):
    return replace(simulation, effects=(*simulation.effects, effect))


@sampled("seed", range(2), "another draw of motion and noise")
def test_a_simulation_that_is_right_is_consistent(given, seed):
    found = diagnose(given, [record(given, seed)])
    assert found.verdict.verdict == "consistent"
    assert found.verdict.findings == ()
    assert closure(found)[1] < CLOSED
    assert error(found.after, given) < 0.01


@pytest.mark.slow("a whole diagnosis")
def test_a_spent_budget_leaves_what_is_proven_and_says_what_was_not_tried(given):
    hidden = PreslidingHysteresis(joint=2, stiffness=(300.0,), width=(0.004,))
    recording = record(plus(given, hidden), 0)
    found = limo.diagnose(given, recording, budget=1e-6)
    assert ("presliding_hysteresis", "missing", (2,)) in names(found)
    assert closure(found)[1] < CLOSED
    assert not found.failures
    (note,) = (note for note in found.verdict.notes if "budget" in note)
    assert "a fit to all rows" in note
    assert "the next motion" in note
    assert found.replay == ()
    with pytest.raises(ConfigError, match="budget is 0 s"):
        limo.diagnose(given, recording, budget=0.0)


@pytest.mark.slow("a whole diagnosis")
def test_a_damped_fall_across_a_gap_is_found_where_it_leaves_something_unexplained(given):
    """It competes with nothing before: where no flank is met, it would be a lag or an armature."""
    hidden = Backlash(joint=2, gap=0.02, damping=100.0)
    true = plus(given, hidden)
    recording = record(true, 0)
    hanging = replace(recording, position=recording.position + np.array([0.0, 1.97]))
    observed = Observations.of(true, [hanging], 10.0)
    noise = NOISE / 20 * np.random.default_rng(5).standard_normal((len(hanging), 2))
    found = diagnose(given, [replace(hanging, torque=observed.predict(true) + noise)])
    assert names(found) == {("backlash", "missing", (2,))}
    play = found.after.effects[-1]
    assert (play.gap, play.damping) == pytest.approx((hidden.gap, hidden.damping), rel=0.05)
    assert closure(found)[1] < CLOSED


@pytest.mark.slow("a whole diagnosis")
def test_a_link_that_swings_on_its_spring_is_found_where_errors_swing(given):
    hidden = JointElasticity(joint=1, stiffness=150.0, damping=0.3)
    true = plus(given, hidden)
    recording = record(true, 0)
    observed = Observations.of(true, [recording], 10.0)
    noise = NOISE / 20 * np.random.default_rng(5).standard_normal((len(recording), 2))
    found = diagnose(given, [replace(recording, torque=observed.predict(true) + noise)])
    assert names(found) == {("joint_elasticity", "missing", (1,))}
    spring = found.after.effects[-1]
    assert spring.stiffness == pytest.approx(hidden.stiffness, rel=0.03)
    assert spring.damping == pytest.approx(hidden.damping, rel=0.3)


@pytest.mark.slow("two whole diagnoses")
def test_a_lag_of_a_sensor_within_its_tolerance_is_neither_unknown_nor_noise(given):
    """Where fast motion turns round, the sign of friction comes half a millisecond late."""
    motion = motion_of(given, 0, 15.0)
    noise = 0.003 * np.random.default_rng(0).standard_normal(motion.position.shape)

    def diagnosed(lag):
        late = [np.interp(motion.time - lag, motion.time, tau) for tau in given.predict(motion).T]
        torque = np.transpose(late) + noise
        return diagnose(given, [Recording.from_arrays(motion.time, motion.position, torque)])

    prompt, late = diagnosed(0.0), diagnosed(5e-4)
    assert late.verdict.verdict == "consistent"
    floors = [found.verdict.fit.noise_floor for found in (late, prompt)]
    np.testing.assert_allclose(*floors, rtol=0.2)


@pytest.mark.slow("two whole diagnoses")
def test_an_arm_of_a_millinewton_metre_is_judged_as_one_of_a_hundred(given):
    """Bodies, friction and noise in another unit of mass: nothing but that unit may change."""

    def diagnosed(strength):
        dry = [replace(effect, tau_c=strength * effect.tau_c) for effect in given.effects[:2]]
        viscous = [replace(effect, f_v=strength * effect.f_v) for effect in given.effects[2:]]
        light = {
            name: replace(
                body,
                mass=strength * body.mass,
                inertia=tuple(strength * value for value in body.inertia),
            )
            for name, body in given.model.inertials.items()
        }
        stated = replace(given, effects=(*dry, *viscous), inertials=light)
        heard = record(given, 0, 30.0)
        heard = Recording.from_arrays(heard.time, heard.position, strength * heard.torque)
        return diagnose(stated, [heard]).verdict

    usual, weak = diagnosed(1.0), diagnosed(1e-5)
    assert weak.verdict == usual.verdict == "consistent"
    for name in ("noise_floor", "heldout_rmse_after"):
        scaled = 1e-5 * np.array(getattr(usual.fit, name))
        np.testing.assert_allclose(getattr(weak.fit, name), scaled, rtol=1e-3)


@pytest.mark.slow("two whole diagnoses")
def test_a_jolt_is_told_and_hides_nothing(given, monkeypatch):
    monkeypatch.setattr(events, "pushes", lambda *_: ())  # with an arm that rings along, none is
    true = plus(given, SpringLoad(joint=2, stiffness=0.15, rest=0.0))
    calm = record(true, 0)
    seen = Observations.of(given, [calm], 10.0)
    quiet = np.flatnonzero(steadily_moving(seen).all(axis=1))
    runs = np.split(quiet, np.flatnonzero(np.diff(quiet) > 1) + 1)
    at = float(np.median(seen.slow.time[max(runs, key=len)]))
    since = np.maximum(calm.time - at, 0.0)
    ring = 10.0 * np.sin(2 * np.pi * 8.0 * since) * np.exp(-since / 0.1)
    rung = Recording.from_arrays(calm.time, calm.position, calm.torque + ring[:, None])

    usual, jolted = (diagnose(given, [heard]).verdict for heard in (calm, rung))

    (told,) = [note for note in jolted.notes if "usual ones at once" in note]
    assert float(told.split()[1]) == pytest.approx(at, abs=0.3)
    assert "joints 1 (shoulder) and 2 (elbow)" in told
    assert [(f.effect, f.joints) for f in jolted.findings] == [("spring_load", (2,))]
    np.testing.assert_allclose(jolted.fit.noise_floor, usual.fit.noise_floor, rtol=0.2)


@pytest.mark.slow("a whole diagnosis")
def test_a_push_that_larger_errors_hid_is_taken_out_once_they_are(given, monkeypatch):
    scans = iter([(), (PUSH,), (PUSH,)])  # of the first set, of the whole one, and without its rows
    monkeypatch.setattr(events, "pushes", lambda *_: next(scans))
    found = diagnose(given, [record(given, 0)])
    assert [item.effect for item in found.verdict.findings] == ["external_contact"]
    assert found.verdict.findings[0].where.time == ((20.0, 21.0),)
    assert next(scans, "none is left") == "none is left"
    near = (found.traces.time > 20.0) & (found.traces.time < 21.0)
    assert not found.traces.held_out[near].any()


@pytest.mark.slow("two whole diagnoses")
def test_what_looks_like_a_push_only_beside_missing_effects_is_none_and_its_rows_count(
    given, monkeypatch
):
    scans = iter([(PUSH,), (), ()])  # of the first set, without its rows, and with them again
    monkeypatch.setattr(events, "pushes", lambda *_: next(scans))
    found = diagnose(given, [record(given, 0)])
    assert found.verdict.verdict == "consistent"
    assert next(scans, "none is left") == "none is left"
    monkeypatch.setattr(events, "pushes", lambda *_: ())
    assert found.verdict.rows == diagnose(given, [record(given, 0)]).verdict.rows


def test_it_tells_its_progress_keeps_blas_to_one_thread_and_gives_the_others_back(given):
    def threads():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    with threadpool_limits(2, user_api="blas"):
        told = []
        diagnose(given, [record(given, 0)], progress=lambda _, done: told.append((done, threads())))
        assert threads() == {2}
    assert all(number == {1} for _, number in told)
    done = [item[0] for item in told]
    assert done == sorted(done)
    assert done[0] == 0.0
    assert done[-1] == 1.0


@pytest.mark.slow("a whole diagnosis")
def test_intervals_that_fail_leave_the_verdict(given, monkeypatch):
    def failing(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(pipeline, "with_parameters", failing)
    found = diagnose(given, [record(plus(given, TorqueGain(joint=1, gain=0.08)), 1)])
    assert names(found) == {("torque_gain", "missing", (1,))}
    (failure,) = found.failures
    assert "intervals (LinAlgError: Singular matrix)" in found.verdict.notes[0] == failure.note()
    assert isinstance(failure.error, np.linalg.LinAlgError)


@pytest.mark.slow("a whole diagnosis")
def test_a_low_bandwidth_makes_no_hysteresis_of_reversals(given):
    """A filter that reaches farther spreads what happens at a reversal farther."""
    assert names(diagnose(given, [record(given, 1, 120.0)], bandwidth=4.0)) == set()


@pytest.mark.slow("a whole diagnosis")
@pytest.mark.parametrize("seed", range(2))
def test_what_is_off_within_tolerances_is_consistent_and_mended(given, seed):
    """The friction is 15 % larger, one deviation; the improved simulation says so."""
    more = tuple(
        replace(effect, tau_c=1.15 * effect.tau_c)
        if isinstance(effect, CoulombFriction)
        else effect
        for effect in given.effects
    )
    true = replace(given, effects=more)
    found = diagnose(given, [record(true, seed)])
    assert found.verdict.verdict == "consistent"
    assert closure(found)[0] > 2
    assert closure(found)[1] < CLOSED
    assert error(found.after, true) < 0.2 * error(given, true)


@pytest.mark.slow("searches at both joints what is stated in the other tests: fifteen seconds")
def test_ordinary_friction_is_identified_and_what_hides_behind_it_is_found(given):
    """A bare robot description is where most users start."""
    slip = PreslidingHysteresis(joint=2, stiffness=(30.0, 10.0), width=(0.01, 0.05))
    found = diagnose(replace(given, effects=()), [record(plus(given, slip), 3)])
    assert names(found) == {("presliding_hysteresis", "missing", (2,))}
    assert found.verdict.findings[0].share > 0.9
    assert closure(found)[1] < CLOSED
    identified = {(item.effect, item.joint): item for item in found.verdict.identified}
    assert set(identified) == {(effect.name, effect.joint) for effect in given.effects}
    for effect, name in zip(given.effects, ("tau_c", "tau_c", "f_v", "f_v"), strict=True):
        known = identified[effect.name, effect.joint].parameters[name]
        assert known.value == pytest.approx(getattr(effect, name), rel=0.1)
        low, high = known.ci95
        assert low < known.value < high


@pytest.mark.slow("a whole diagnosis")
def test_friction_that_is_all_that_is_missing_is_no_finding(given):
    found = diagnose(replace(given, effects=()), [record(given, 1)])
    assert found.verdict.verdict == "consistent"
    assert found.verdict.findings == ()
    listed = found.verdict.as_values()["identified"]
    assert [(item["effect"], item["joint"]) for item in listed] == [
        (name, joint) for joint in (1, 2) for name in ("coulomb_friction", "viscous_friction")
    ]
    assert all(len(item["parameters"][name]["ci95"]) == 2
               for item, name in zip(listed, 2 * ("tau_c", "f_v"), strict=True))  # fmt: skip
    assert error(found.after, given) < 0.02


@pytest.mark.slow("a whole diagnosis")
def test_gains_inside_their_tolerance_are_no_finding_and_are_mended(given):
    """Torques that are currents times a constant that is good to 10 %; friction unknown."""
    gains = (TorqueGain(joint=1, gain=0.08), TorqueGain(joint=2, gain=-0.1))
    true = replace(given, effects=(*given.effects, *gains))
    tolerant = replace(given, effects=(), tolerances=Tolerances(inertia=0.01, gain=0.1))
    found = diagnose(tolerant, [record(true, 3)])
    assert names(found) == set()
    assert closure(found)[1] < CLOSED
    assert error(found.after, true) < 0.02
    mended = {e.joint: e.gain for e in found.after.effects if isinstance(e, TorqueGain)}
    assert mended == pytest.approx({1: 0.08, 2: -0.1}, abs=0.01)


@pytest.mark.slow("a whole diagnosis")
def test_no_friction_is_named_where_the_torque_has_none(given):
    """A torque that is measured on the link side."""
    link_side = replace(given, effects=())
    verdict = diagnose(link_side, [record(link_side, 4)]).verdict
    assert verdict.verdict == "consistent"
    assert verdict.identified == ()


@pytest.fixture(scope="module")
def hysteresis(given):
    slip = PreslidingHysteresis(joint=2, stiffness=(30.0, 10.0), width=(0.01, 0.05))
    true = plus(given, slip)
    return true, diagnose(given, [record(true, 3)])


@pytest.mark.slow("a whole diagnosis")
def test_hysteresis_is_named_at_its_joint_and_modelled(hysteresis, given):
    true, found = hysteresis
    assert names(found) == {("presliding_hysteresis", "missing", (2,))}
    assert found.verdict.verdict == "explained"
    before, after = closure(found)
    assert before > 10
    assert after < CLOSED
    assert error(found.after, true) < 0.05 * error(given, true)
    finding = found.verdict.findings[0]
    assert finding.share > 0.9
    assert finding.confidence > 0.8
    stiffness, width = (np.array(finding.parameters[p].value) for p in ("stiffness", "width"))
    assert stiffness @ width == pytest.approx(0.8, rel=0.1)  # height of its loop [N m]


@pytest.mark.slow("a whole diagnosis")
def test_the_fit_says_how_much_of_the_error_is_gone(hysteresis):
    fit = hysteresis[1].verdict.fit
    low, high = fit.ci95
    assert 0.95 < low <= fit.reducible_error_removed <= high <= 1.0


@pytest.mark.slow("a whole diagnosis")
def test_traces_have_the_rows_that_were_compared(hysteresis):
    traces = hysteresis[1].traces
    rows = traces.time.size
    assert traces.measured.shape == traces.before.shape == traces.after.shape == (rows, 2)
    assert np.all(np.diff(traces.time) > 0)
    held = traces.held_out
    left, given = (
        np.sqrt(np.mean((traces.measured - torque)[held] ** 2, axis=0))
        for torque in (traces.after, traces.before)
    )
    assert left[0] <= given[0]  # of which nothing is reported
    assert left[1] < 0.1 * given[1]


@pytest.mark.slow("a whole diagnosis")
def test_the_chosen_explanation_is_the_likeliest(hysteresis):
    explanations = hysteresis[1].explanations
    assert explanations[0].effects == ("presliding_hysteresis",)
    assert explanations[0].joints == ((2,),)
    evidence = [item.log_evidence for item in explanations]
    assert evidence == sorted(evidence, reverse=True)


@pytest.mark.slow("a whole diagnosis")
def test_a_drift_is_named_and_not_handed_on(given):
    """Another recording drifts in another way, or not at all."""
    times = tuple(np.linspace(0.0, 60.0, 7).tolist())
    drift = TorqueDrift(joint=2, times=times, offset=(0.0, 0.2, 0.5, 0.3, -0.1, -0.4, -0.2))
    found = diagnose(given, [record(plus(given, drift), 1)])
    assert ("torque_drift", "missing", (2,)) in names(found)
    assert not any(effect.name == "torque_drift" for effect in found.after.effects)
    assert any("not written into the improved simulation" in note for note in found.verdict.notes)


@pytest.mark.slow("two whole diagnoses")
def test_six_seconds_are_enough_for_what_they_show(given):
    found = diagnose(given, [record(plus(given, TorqueGain(joint=1, gain=0.3)), 1, 6.0)])
    assert ("torque_gain", "missing", (1,)) in names(found) or any(
        "torque_gain" in item.equivalent for item in found.verdict.findings
    )
    none = diagnose(given, [record(given, 2, 6.0)])
    assert none.verdict.findings == ()


def test_a_gain_is_named_at_its_joint(given):
    true = plus(given, TorqueGain(joint=1, gain=0.08))
    found = diagnose(given, [record(true, 1)])
    assert names(found) == {("torque_gain", "missing", (1,))}
    gain = found.verdict.findings[0].parameters["gain"]
    assert gain.value == pytest.approx(0.08, rel=0.1)
    assert gain.ci95[0] < 0.08 < gain.ci95[1]
    assert closure(found)[1] < CLOSED


@pytest.mark.slow("a whole diagnosis")
def test_a_joint_that_a_fit_harms_stays_as_stated_and_the_others_are_mended(given):
    """Joint 2 rubs less in the blocks held out than elsewhere; a spring acts on joint 1."""
    whole = record(plus(given, SpringLoad(joint=1, stiffness=3.0, rest=0.2)), 0)
    part = (8 * np.arange(len(whole)) // len(whole))[:, None]  # of eight, (2, 5) are held out
    is_friction = given.predict(whole) - replace(given, effects=given.effects[::2]).predict(whole)
    more = np.where(np.isin(part, HELD_OUT.which), -0.3, 0.3) * is_friction
    recording = Recording.from_arrays(whole.time, whole.position, whole.torque + more)
    found = diagnose(given, [recording])
    assert ("spring_load", "missing", (1,)) in names(found)
    fit = found.verdict.fit
    assert fit.heldout_rmse_after[0] < 0.1 * fit.heldout_rmse_before[0]
    assert fit.heldout_rmse_after[1] < fit.heldout_rmse_before[1] + 0.5 * fit.noise_floor[1]


def test_values_held_exact_to_prove_a_set_are_tolerated_as_before(given, monkeypatch):
    def held(self):
        problem = self.problem.with_stated_values()
        return JudgedSet.of(fitted(problem, (), self.solution.noise)), False

    monkeypatch.setattr(JudgedSet, "without_harmful_members", held)
    assert diagnose(given, [record(given, 0, 10.0)]).after.tolerances == given.tolerances


@pytest.fixture(scope="module")
def doubled(given):
    effects = (given.effects[0], replace(given.effects[1], tau_c=1.2), *given.effects[2:])
    true = replace(given, effects=effects)
    return true, diagnose(given, [record(true, 2)])


@pytest.mark.slow("a whole diagnosis")
def test_friction_that_doubled_is_a_wrong_parameter(doubled):
    _, found = doubled
    assert names(found) == {("coulomb_friction", "wrong_parameter", (2,))}
    assert found.after.effects[1].tau_c == pytest.approx(1.2, rel=0.01)
    assert closure(found)[1] < CLOSED


@pytest.mark.slow("a whole diagnosis")
def test_friction_that_grew_sharper_than_it_is_stated_is_a_wrong_parameter(given):
    """How sharp a sign is, is guessed; a change of friction does not follow the guess."""
    stated, known = replace(given.effects[1], v_eps=0.03), 1.2
    given = replace(given, effects=(given.effects[0], stated, *given.effects[2:]))
    recording = record(given, 2)
    sharp = np.tanh(recording.motion(10.0).velocity[:, 1] / 0.004)
    more = np.stack([np.zeros_like(sharp), known * sharp], axis=1)
    torque = recording.torque + more
    found = diagnose(given, [Recording.from_arrays(recording.time, recording.position, torque)])
    assert names(found) == {("coulomb_friction", "wrong_parameter", (2,))}
    assert found.after.effects[1].tau_c == pytest.approx(stated.tau_c + known, rel=0.05)
    assert closure(found)[1] < CLOSED


@pytest.mark.slow("a whole diagnosis each")
@pytest.mark.parametrize("times", [0.1, 0.5])
def test_friction_that_is_but_sharper_than_it_is_stated_is_no_finding(given, times):
    """Its size is within its tolerance; over which speeds the sign turns was a guess."""
    stated = tuple(replace(effect, v_eps=0.03) for effect in given.effects[:2])
    true = tuple(replace(x, tau_c=1.25 * x.tau_c, v_eps=times * x.v_eps) for x in stated)
    recording = record(replace(given, effects=(*true, *given.effects[2:])), 2)
    found = diagnose(replace(given, effects=(*stated, *given.effects[2:])), [recording])
    assert names(found) == set()
    assert closure(found)[1] < CLOSED


@pytest.mark.slow("two whole diagnoses")
def test_the_same_input_gives_the_same_verdict(doubled, given):
    true, found = doubled
    again = diagnose(given, [record(true, 2)])
    assert again.verdict.as_values() == found.verdict.as_values()
    assert again.after == found.after


@pytest.mark.slow("a whole diagnosis")
def test_the_verdict_reports_the_value_that_the_improved_simulation_has(doubled):
    _, found = doubled
    reported = found.verdict.findings[0].parameters["tau_c"]
    assert reported.ci95[0] < 1.2 < reported.ci95[1]
    assert reported.value == pytest.approx(found.after.effects[1].tau_c)


@pytest.mark.slow("a whole diagnosis each")
@pytest.mark.parametrize(
    ("true", "name"),
    [(CoulombFriction(joint=2, tau_c=0.6), "tau_c"), (ViscousFriction(joint=1, f_v=3.0), "f_v")],
)
def test_friction_stated_twice_too_large_is_a_wrong_parameter(given, true, name):
    """Stated 3.3 sigma off: nearly all of that, but not all, could be within its tolerance."""
    others = tuple(item for item in given.effects if item.place != true.place)
    stated = replace(true, **{name: 2 * getattr(true, name)})
    recording = record(replace(given, effects=(true, *others)), 2)
    found = diagnose(replace(given, effects=(stated, *others)), [recording])
    assert names(found) == {(true.name, "wrong_parameter", true.joints)}
    assert found.verdict.verdict == "explained"
    value = found.verdict.findings[0].parameters[name].value
    assert value == pytest.approx(getattr(true, name), rel=0.02)
    assert closure(found)[1] < CLOSED


@pytest.mark.slow("a whole diagnosis")
def test_a_wrong_value_is_found_where_a_sign_is_but_sharper_beside_it(given):
    """Dry friction of that joint, sharper once the value is held as stated, is no other name."""
    true = ViscousFriction(joint=1, f_v=3.0)
    dry, *others = (item for item in given.effects if item.place != true.place)
    recording = record(replace(given, effects=(true, dry, *others)), 2)
    stated = replace(true, f_v=2 * true.f_v), replace(dry, v_eps=10 * dry.v_eps)
    found = diagnose(replace(given, effects=(*stated, *others)), [recording])
    assert names(found) == {("viscous_friction", "wrong_parameter", (1,))}
    assert found.verdict.findings[0].parameters["f_v"].value == pytest.approx(true.f_v, rel=0.02)


@pytest.mark.slow("diagnoses an arm of seven joints")
def test_a_payload_is_named_with_its_mass():
    iiwa = Simulation("iiwa14", tuple(CoulombFriction(joint=j, tau_c=1.0) for j in range(1, 8)))
    payload = Payload(mass=1.5, com=(0.02, 0.0, 0.08), inertia=(0.005, 0.0, 0.0, 0.005, 0.0, 0.005))
    true = plus(iiwa, payload)
    found = diagnose(iiwa, [record(true, 4, duration=25.0)])
    assert names(found) == {("payload", "missing", (7,))}
    parameters = found.verdict.findings[0].parameters
    assert parameters["mass"].value == pytest.approx(1.5, rel=0.05)
    np.testing.assert_allclose(parameters["com"].value, payload.com, atol=0.02)
    assert closure(found)[1] < CLOSED
    assert error(found.after, true) < 0.02 * error(iiwa, true)


def with_product(simulation, seed):
    """Record with a torque at joint 1 that goes with the product of both velocities."""
    recording, motion = record(simulation, seed), motion_of(simulation, seed)
    v, torque = motion.velocity, np.array(recording.torque)
    torque[:, 0] += 0.3 * np.tanh(6 * v[:, 0] * v[:, 1]) * np.cos(motion.position[:, 1])
    return replace(recording, torque=torque)


@pytest.mark.slow("a whole diagnosis")
def test_what_nothing_explains_is_unknown_at_its_joint(given):
    """What goes with the product of both velocities is in no catalogue."""
    found = diagnose(given, [with_product(given, 5)])
    assert (UNKNOWN, (1,)) in {(item.effect, item.joints) for item in found.verdict.findings}
    assert found.verdict.verdict in {"unexplained", "partly_explained"}
    assert found.verdict.unexplained.joints == (1,)


@pytest.mark.slow("a whole diagnosis")
def test_a_value_at_its_limit_is_not_blamed_for_what_nothing_explains(given):
    """The friction is three deviations larger, and the fit has it at the end of its tolerance."""
    more = replace(given.effects[0], tau_c=1.46 * given.effects[0].tau_c)
    found = diagnose(given, [with_product(replace(given, effects=(more, *given.effects[1:])), 5)])
    assert names(found) == {(UNKNOWN, "missing", (1,))}
    dry = next(item for item in found.shifts if item.name == "tau_c of joint 1 (coulomb friction)")
    assert dry.sigmas == pytest.approx(3.0)


def test_a_recording_of_another_robot_is_refused(given):
    t = np.arange(6000) / RATE
    position = 0.3 * np.sin(t)[:, None] * np.ones(3)
    with pytest.raises(RecordingError, match=r"has 3 joints, but \S*two_joints\S* has 2"):
        diagnose(given, [Recording.from_arrays(t, position, position)])


@pytest.mark.slow("diagnoses an arm of seven joints")
def test_a_joint_without_torque_is_left_out_by_name_and_the_others_are_judged():
    iiwa = Simulation("iiwa14", tuple(CoulombFriction(joint=j, tau_c=1.0) for j in range(1, 8)))
    payload = Payload(mass=1.5, com=(0.02, 0.0, 0.08), inertia=(0.005, 0.0, 0.0, 0.005, 0.0, 0.005))
    whole = record(plus(iiwa, payload), 4, duration=25.0)
    torque = np.array(whole.torque)
    torque[:, 2] = 0.0
    found = diagnose(iiwa, [replace(whole, torque=torque)])
    assert names(found) == {("payload", "missing", (7,))}
    assert (
        "Joint 3 is left out: no torque is measured there, 0 N m in all rows."
        in found.verdict.notes
    )
    assert found.verdict.rows.usable[2] == 0
    assert found.verdict.fit.heldout_rmse_before_all_rows[2] == 0.0
    (line,) = [text for text in str(found).splitlines() if text.startswith("    3 ")]
    assert line.split() == ["3", "-", "-", "-", "-", "0", "%", "-", "-"]


@pytest.mark.slow("a whole diagnosis of seven joints")
def test_a_joint_that_binds_is_named_though_nothing_else_is_unusual():
    """Its friction is in what predictions have to beat; nothing of it may be lost for that."""
    usual = np.array([2.2, 2.8, 1.6, 1.5, 1.0, 0.4, 0.4])  # [N m]
    binds = np.where(np.arange(7) == 2, 8.0, 1.0) * usual
    arm = Simulation(
        "iiwa14", tuple(CoulombFriction(joint=j, tau_c=tau) for j, tau in enumerate(binds, start=1))
    )
    found = diagnose(Simulation("iiwa14"), [record(arm, 4, duration=25.0)])
    assert names(found) == {("coulomb_friction", "missing", (3,))}
    (finding,) = found.findings
    assert finding.parameters["tau_c"].value == pytest.approx(8.0 * 1.6, rel=0.05)
    dry = {item.joint for item in found.verdict.identified if item.effect == "coulomb_friction"}
    assert dry == {1, 2, 4, 5, 6, 7}


def test_recordings_without_any_torque_are_refused(given):
    whole = record(given, 0)
    with pytest.raises(RecordingError, match="N m in all rows; expected measured torque"):
        diagnose(given, [replace(whole, torque=0.0 * whole.torque)])
