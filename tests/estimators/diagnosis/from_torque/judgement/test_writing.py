"""What is written into the improved simulation holds on motion of another kind."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.diagnosis import diagnose
from estimators.diagnosis.comparison import BODIES, widths_of
from estimators.diagnosis.from_torque.fitting.laws import in_domains
from estimators.diagnosis.from_torque.judgement import writing
from estimators.diagnosis.from_torque.judgement.telling import without_unreported
from estimators.diagnosis.from_torque.judgement.writing import (
    Elsewhere,
    Written,
    still_named,
    withheld,
    without,
)
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.held_out import Split, of_another_kind
from estimators.diagnosis.settings import FAR
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics import (
    CoulombFriction,
    JointCoupling,
    Payload,
    PositionDependentFriction,
    QuadraticDrag,
    SpringLoad,
    TorqueDrift,
    TorqueOffset,
    TorqueRipple,
    ViscousFriction,
)
from limo_driver.physics.domain import Domain
from limo_driver.recordings.recording import Recording


def plus(simulation, *effects):
    return replace(simulation, effects=(*simulation.effects, *effects))


VISCOUS = ViscousFriction(joint=2, f_v=3.0)
OFFSET = TorqueOffset(joint=1, offset=0.2)


@pytest.fixture(scope="module")
def recordings(rigid, training_recording, test_recording):
    """Motion of an arm with viscous friction at joint 2, which the simulation does not have."""
    true, random = plus(rigid, VISCOUS), np.random.default_rng(3)

    def again(recording):
        motion = recording.motion(10.0)
        torque = true.predict(motion) + 0.02 * random.standard_normal(motion.position.shape)
        return Recording.from_arrays(motion.time, motion.position, torque)

    return again(training_recording), again(test_recording)


@pytest.fixture(scope="module")
def observed(rigid, recordings):
    return Observations.of(rigid, recordings, 10.0)


def proof(observed, fitted):
    """Return the proof of a fit that is the same whatever motion is left out, and of that fit."""
    kind, chosen = of_another_kind(observed)
    beside = observed.under(fitted)
    turns = tuple((beside, rows) for rows in chosen)
    return Elsewhere(kind, observed.simulation, np.full(2, 0.02), turns), beside


@dataclass(frozen=True)
class SimpleJudged:
    """A judged set, as far as what is written of it changes."""

    beside: Observations

    @property
    def problem(self):
        return SimpleNamespace(split=Split.of(self.beside))


def names(found):
    return {item.part for item in found}


def test_recordings_that_move_one_joint_each_are_not_left_out_whole(rigid, training_recording):
    """Without the one that moves a joint nothing is known of it, so nothing could be proven."""
    motion = training_recording.motion(10.0)

    def of_joints(*moved):
        held = [j for j in range(motion.position.shape[1]) if j not in moved]
        position = motion.position.copy()
        position[:, held] = position[0, held]
        return Recording.from_arrays(motion.time, position, training_recording.torque)

    alone = Observations.of(rigid, (of_joints(0), of_joints(1)), 10.0)
    kind, chosen = of_another_kind(alone)
    assert kind == "blocks of other speeds and poses"
    assert all(alone.moving[~rows].any(axis=0).all() for rows in chosen)
    both = Observations.of(rigid, (of_joints(0, 1), of_joints(0, 1)), 10.0)
    assert of_another_kind(both)[0] == "whole recordings"


@pytest.mark.parametrize(("speeds", "times"), [("a swing", FAR), ("one speed", 1.0)])
def test_a_slope_goes_on_as_far_as_speeds_have_told_it_from_dry_friction(rigid, speeds, times):
    """At one speed alone both are as likely; beyond it the slope is the one that was stated."""
    time = np.arange(0.0, 20.0, 0.01)
    swing = np.sin(0.7 * time)
    course = (swing if speeds == "a swing" else np.arcsin(swing)) / 0.7
    position = np.stack([course, course], axis=1)
    recording = Recording.from_arrays(time, position, np.zeros_like(position))
    given = plus(rigid, ViscousFriction(joint=1, f_v=1.0))
    fitted = Observations.of(plus(rigid, ViscousFriction(joint=1, f_v=2.0)), (recording,), 10.0)
    domain = in_domains(fitted, given, fitted.moving).simulation.effects[-1].domain
    seen = np.abs(fitted.slow.velocity[fitted.moving[:, 0], 0]).max()
    assert domain.slope == 1.0
    assert domain.speed == pytest.approx(times * seen, rel=0.15)


def test_what_makes_a_joint_better_is_written(observed, rigid):
    assert withheld(*proof(observed, plus(rigid, VISCOUS))) == ()


def test_the_part_that_makes_a_joint_worse_is_not_written_and_the_others_are(observed, rigid):
    spring = SpringLoad(joint=2, stiffness=1.0, rest=0.0)
    found = withheld(*proof(observed, plus(rigid, VISCOUS, spring, OFFSET)))
    assert names(found) == {"spring load, joint 2", "torque offset, joint 1"}
    assert "joint 1 +" in {item.part: item.why for item in found}["torque offset, joint 1"]


def test_what_may_as_well_be_better_as_worse_is_written(observed, rigid):
    tiny = TorqueOffset(joint=1, offset=1e-9)
    assert withheld(*proof(observed, plus(rigid, VISCOUS, tiny))) == ()


def test_bodies_and_couplings_that_make_the_arm_worse_are_not_written(observed, rigid):
    link = rigid.model.link_names[-1]
    body = rigid.model.inertials[link]
    heavy = Inertial(2 * body.mass, body.com, tuple(2 * x for x in body.inertia))
    coupled = JointCoupling(joint=1, other=2, f_v=2.0)
    improved = replace(plus(rigid, VISCOUS, coupled), inertials={link: heavy})
    found = names(withheld(*proof(observed, improved)))
    assert "the inertias of links" in found
    assert any(name.startswith("joint coupling") for name in found)
    assert "viscous friction, joint 2" not in found


def test_a_body_that_makes_a_joint_better_is_written_beside_what_makes_another_worse(
    observed, rigid
):
    """As of a heavier link that mends joint 1, beside friction that harms joint 2."""
    link = rigid.model.link_names[-1]
    body = rigid.model.inertials[link]
    heavy = Inertial(2 * body.mass, body.com, tuple(2 * x for x in body.inertia))
    given = plus(rigid, replace(VISCOUS, f_v=2.9))
    improved = observed.under(replace(plus(rigid, VISCOUS), inertials={link: heavy}))

    def change(parts, than=()):  # noqa: ARG001  # as of `Elsewhere`
        bodies, friction = (name not in parts for name in (BODIES, "viscous friction, joint 2"))
        middle = np.array([-0.9 * bodies, 0.02 * friction + 1e-4 * bodies])
        return np.stack([middle, middle - 1e-3, middle + 1e-3])

    elsewhere = SimpleNamespace(
        given=given, floor=np.full(2, 0.02), as_given=np.ones(2), change=change
    )

    assert names(withheld(elsewhere, improved)) == {"viscous friction, joint 2"}


def test_a_body_that_makes_the_arm_better_is_written_although_a_joint_is_hardly_worse(
    rigid, training_recording
):
    """As a load that is known well, and friction that is off by next to nothing."""
    load = Payload(mass=0.5, com=(0.1, 0.0, 0.0), inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    slight = TorqueOffset(joint=2, offset=0.004)
    motion = training_recording.motion(10.0)
    noise = 0.02 * np.random.default_rng(4).standard_normal(motion.position.shape)
    torque = plus(rigid, load).predict(motion) + noise
    carried = Recording.from_arrays(motion.time, motion.position, torque)
    observed = Observations.of(rigid, [carried], 10.0)
    assert "payload" not in names(withheld(*proof(observed, plus(rigid, load, slight))))


def test_what_acts_at_one_place_alone_is_not_written(observed, rigid):
    """As friction that was found at one end, where the arm was for a moment."""
    end = float(observed.slow.position[:, 1].max())
    places = (end - 0.004, end - 0.002, end)
    there = PositionDependentFriction(joint=2, positions=places, excess=(0.0, 0.5, 0.5))
    found = withheld(*proof(observed, plus(rigid, VISCOUS, there)))
    assert names(found) == {"position dependent friction, joint 2"}
    assert "% of the rows alone" in found[0].why


def test_what_acts_seldom_is_written_where_it_surely_helps_elsewhere(observed, rigid, monkeypatch):
    monkeypatch.setattr(writing, "ELSEWHERE", replace(writing.ELSEWHERE, share=1.0))
    tiny = TorqueOffset(joint=1, offset=1e-9)
    found = withheld(*proof(observed, plus(rigid, VISCOUS, tiny)))
    assert names(found) == {"torque offset, joint 1"}


@pytest.mark.parametrize(
    ("told", "states", "written"),
    [
        pytest.param(False, ("agrees",), 2.9, id="what agrees"),
        pytest.param(True, ("stated values differ",), 3.0, id="what is told"),
        pytest.param(False, ("physics is missing",), 3.0, id="a joint that errs more without"),
    ],
)
def test_a_stated_value_that_moved_is_written_where_it_is_told(
    observed, rigid, told, states, written
):
    given = plus(rigid, replace(VISCOUS, f_v=2.9))
    elsewhere, improved = proof(observed.under(given), plus(rigid, VISCOUS))
    value = SimpleNamespace(effect=VISCOUS.name, joints=(2,), reported=told)
    verdict = SimpleNamespace(values=(value,), findings=(), identified=(), states=states)
    found = Written(SimpleJudged(improved), improved, elsewhere=elsewhere)

    effect = without_unreported(found, verdict).improved.simulation.effects[-1]

    assert effect.f_v == written


def test_parts_that_make_good_what_each_other_does_are_as_given_together(observed, rigid):
    """Of one another each is needed; of both, the joint gains nothing."""
    constant = TorqueRipple(
        joint=1, amplitude=(0.2,), cycles_per_rev=(1e-3,), phase=(-np.pi / 2,)
    )  # of a period so long that it is an offset of -0.2 N m
    elsewhere, improved = proof(observed, plus(rigid, VISCOUS, OFFSET, constant))
    found = SimpleNamespace(effect=VISCOUS.name, joints=(2,))
    verdict = SimpleNamespace(
        values=(), findings=(found,), identified=(), states=("physics is missing",)
    )
    written = without_unreported(
        Written(SimpleJudged(improved), improved, elsewhere=elsewhere), verdict
    )
    assert written.improved.simulation.effects == (*rigid.effects, VISCOUS)


@pytest.mark.parametrize(
    ("part", "written"),
    [
        pytest.param(0.98, True, id="about as good elsewhere"),
        pytest.param(1.1, False, id="worse elsewhere"),
    ],
)
def test_motion_of_the_same_kind_tells_where_that_of_another_kind_does_not(
    observed, rigid, part, written
):
    """Of friction that is right without the first recording, and far off without the second."""
    kind, chosen = of_another_kind(observed)
    first, second = (np.sum(observed.slow.velocity[rows, 1] ** 2) for rows in chosen)
    off = VISCOUS.f_v * (1.0 + np.sqrt(part * (first + second) / second))
    fits = (observed.under(plus(rigid, replace(VISCOUS, f_v=f_v))) for f_v in (3.0, off))
    elsewhere = Elsewhere(kind, rigid, np.full(2, 0.02), tuple(zip(fits, chosen, strict=True)))
    improved = observed.under(plus(rigid, VISCOUS))
    verdict = SimpleNamespace(
        values=(), findings=(), identified=(), states=("something unexplained remains",)
    )
    found = without_unreported(
        Written(SimpleJudged(improved), improved, elsewhere=elsewhere), verdict
    )
    assert (VISCOUS in found.improved.simulation.effects) is written


@pytest.mark.parametrize("again", [True, False])
def test_what_passes_is_written_if_it_came_again_in_a_recording_left_out_whole(
    rigid, recordings, again
):
    drift = TorqueDrift(joint=1, times=(0.0, 20.0), offset=(-0.5, 0.5))
    random = np.random.default_rng(5)

    def drifted(recording, arm):
        motion = recording.motion(10.0)
        torque = arm.predict(motion) + 0.02 * random.standard_normal(motion.position.shape)
        return Recording.from_arrays(motion.time, motion.position, torque)

    arms = plus(rigid, drift), plus(rigid, drift) if again else rigid
    observed = Observations.of(rigid, list(map(drifted, recordings, arms)), 10.0)
    _, (first, second) = of_another_kind(observed)
    turns = (observed.under(arms[1]), first), (observed.under(arms[0]), second)  # of the other one
    elsewhere = Elsewhere("whole recordings", rigid, np.full(2, 0.02), turns)
    improved = observed.under(plus(rigid, drift))
    written = Written(SimpleJudged(improved), improved, elsewhere=elsewhere)
    assert written.recurs(drift) is again


@pytest.mark.parametrize("saturates", [False, True])
def test_a_drag_goes_on_as_itself_if_that_holds_beyond_the_speeds_it_was_learned_from(
    rigid, recordings, saturates
):
    motions = [recording.motion(10.0) for recording in recordings]
    slow = 0.4 * max(float(np.abs(motion.velocity[:, 0]).max()) for motion in motions)
    found = QuadraticDrag(joint=1, coefficient=3.0, domain=Domain(speed=slow))
    true = plus(rigid, found if saturates else replace(found, domain=None))
    random = np.random.default_rng(6)
    draggy = [
        Recording.from_arrays(
            motion.time,
            motion.position,
            true.predict(motion) + 0.02 * random.standard_normal(motion.position.shape),
        )
        for motion in motions
    ]
    elsewhere, _ = proof(Observations.of(rigid, draggy, 10.0), plus(rigid, found))
    assert elsewhere.reaches is not saturates


def test_without_parts_a_simulation_is_as_given(rigid):
    improved = plus(rigid, VISCOUS, OFFSET)
    assert without(improved, rigid, ["viscous friction, joint 2"]) == plus(rigid, OFFSET)
    assert (
        without(improved, rigid, ["viscous friction, joint 2", "torque offset, joint 1"]) == rigid
    )


def test_several_recordings_are_left_out_whole_and_of_one_the_fastest_and_the_ends(
    observed, rigid, recordings
):
    kind, chosen = of_another_kind(observed)
    assert kind == "whole recordings"
    assert [set(observed.recording[rows]) for rows in chosen] == [{0}, {1}]
    alone = Observations.of(rigid, recordings[:1], 10.0)
    kind, (fast, slow, low, high) = of_another_kind(alone)
    assert kind == "blocks of other speeds and poses"
    speed = np.abs(alone.slow.velocity).sum(axis=1)
    assert speed[fast].mean() > speed.mean() > speed[slow].mean()
    middle = [alone.slow.position[rows].mean(axis=0) for rows in (low, high, fast, slow)]
    assert np.linalg.norm(middle[0] - middle[1]) > np.linalg.norm(middle[2] - middle[3])


def test_rows_near_those_left_out_are_not_fitted_to(observed):
    rows = np.zeros(len(observed.kept), dtype=bool)
    rows[100:200] = True
    split = Split.without(observed, rows)
    own = observed.recording == observed.recording[100]
    fitted = observed.slow.time[own & split.fitted.any(axis=1)]
    assert np.abs(fitted[:, None] - observed.slow.time[rows]).min() >= 0.9
    assert not (split.fitted & split.held_out).any()


def test_a_diagnosis_says_what_it_wrote_and_what_not(rigid, recordings):
    found = diagnose(rigid, recordings)
    assert found.verdict.fit.left_out == "whole recordings"
    assert not any(part.endswith("joint 2") for part in found.verdict.withheld)
    assert any(effect.place == VISCOUS.place for effect in found.simulation.effects)
    kept = found.simulation.effects
    for part in found.verdict.withheld:
        assert part not in {effect.place.replace("_", " ") for effect in kept} - {
            effect.place.replace("_", " ") for effect in rigid.effects
        }


def test_a_sentence_names_what_is_not_written(observed, rigid):
    elsewhere, beside = proof(observed, plus(rigid, VISCOUS, OFFSET))
    keep = Written(None, beside, withheld(elsewhere, beside), elsewhere.kind, unsure=(1, 2))
    said, unsure = keep.notes()
    assert "not surely better than the given one at joints 1, 2" in unsure
    assert "torque offset, joint 1 (RMSE of joint 1 +" in said
    assert "whole recordings were left out" in said


def test_a_law_that_is_not_written_has_no_name_and_what_it_was_found_for_is_unknown():
    """Of one joint whose error is far above its floor, and another whose error is its floor."""
    candidates = [
        SimpleNamespace(effect="spring_load", joints=(0,)),
        SimpleNamespace(effect="torque_offset", joints=(1,)),
        SimpleNamespace(effect="link_inertia", joints=(1,)),
        SimpleNamespace(effect="joint_coupling", joints=(0, 1)),
    ]
    rows = np.ones((4, 2), dtype=bool)
    problem = SimpleNamespace(
        candidates=candidates, split=SimpleNamespace(held_out=rows),
        observed=SimpleNamespace(n=2),
    )  # fmt: skip
    judged = SimpleNamespace(
        problem=problem, remaining=SimpleNamespace(floor=np.ones(2)),
        proven=np.array([[5.0, 1.0]] * 4),
        findings=(0, 1, 2, 3), named=(0, 1, 2, 3), unknown=(),
    )  # fmt: skip
    assert still_named(judged, []) == ((0, 1, 2, 3), ())
    assert still_named(judged, ["spring load, joint 1"]) == ((1, 2, 3), (0,))
    assert still_named(judged, ["torque offset, joint 2"]) == ((0, 2, 3), ())
    assert still_named(judged, ["the inertias of links"])[0] == (0, 1, 3)
    assert still_named(judged, ["joint coupling, joints 1, 2"]) == ((0, 1, 2), (0,))


def test_the_width_of_a_sign_can_be_as_given_while_its_friction_is_as_fitted(rigid):
    given = plus(rigid, CoulombFriction(joint=1, tau_c=1.0), VISCOUS)
    fitted = plus(rigid, CoulombFriction(joint=1, tau_c=1.4, v_eps=0.01), VISCOUS)
    (width,) = widths_of(fitted, given)
    assert (width.name, width.joints) == ("v_eps of coulomb friction, joint 1", (1,))
    back = without(fitted, given, [width.name])
    assert back == plus(rigid, CoulombFriction(joint=1, tau_c=1.4), VISCOUS)
    assert tuple(widths_of(back, given)) == ()


@pytest.mark.parametrize(
    ("tau_c", "written"),
    [pytest.param(1e-6, 0.002, id="nothing gains"), pytest.param(0.5, 1.0, id="a joint gains")],
)
def test_a_width_that_nothing_surely_gains_by_is_written_as_given(observed, rigid, tau_c, written):
    """Of friction that the arm has not: the wider its sign, the less of it there is."""
    given = plus(rigid, VISCOUS, CoulombFriction(joint=1, tau_c=2 * tau_c))
    moved = CoulombFriction(joint=1, tau_c=tau_c, v_eps=1.0)
    elsewhere, improved = proof(observed.under(given), plus(rigid, VISCOUS, moved))
    value = SimpleNamespace(effect=moved.name, name="tau_c", joints=(1,), reported=True)
    verdict = SimpleNamespace(
        values=(value,), findings=(), identified=(), states=("stated values differ",)
    )
    found = without_unreported(
        Written(SimpleJudged(improved), improved, elsewhere=elsewhere), verdict
    )
    effect = found.improved.simulation.effects[-1]
    assert (effect.tau_c, effect.v_eps) == (tau_c, written)
