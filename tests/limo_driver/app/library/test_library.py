"""What a program can do with the library alone, without commands and files."""

from dataclasses import replace

import numpy as np
import pytest
from mjcf_arms import arm_of

import limo_driver as limo
from limo_driver.errors import ConfigError, JointLimitError, RecordingError
from limo_driver.physics import CoulombFriction, Sensors, ViscousFriction

TRUE = limo.Simulation(
    "iiwa14",
    (
        *(CoulombFriction(joint=j, tau_c=0.5, v_eps=0.002) for j in range(1, 8)),
        *(ViscousFriction(joint=j, f_v=1.0) for j in range(1, 8)),
    ),
    sensors=Sensors(torque_noise=(0.05, 0.05, 0.04, 0.04, 0.03, 0.02, 0.02)),  # [N m]
)


@pytest.fixture(scope="module")
def planned():
    return limo.plan("iiwa14", limo.PlanRequest(scaffolds=1), seed=4)


@pytest.fixture(scope="module")
def recorded(planned):
    return limo.run("mujoco", planned, simulation=TRUE, seed=1)


def test_a_simulation_scores_the_recording_it_made_near_zero(recorded):
    score, bare = TRUE.score(recorded), TRUE.without_effects().score(recorded)
    assert (score.rmse < 0.15 * bare.rmse).all()
    assert score.samples < len(recorded)
    assert str(score).count("\n") == 8  # a heading and seven joints below the line
    assert "RMSE [N m]" in score._repr_html_()


def test_predicting_a_recording_and_its_motion_is_one_word(recorded):
    motion = recorded.motion(10.0)
    whole, smooth = TRUE.predict(recorded), TRUE.predict(motion)
    assert whole.shape == smooth.shape == recorded.torque.shape
    np.testing.assert_array_equal(limo.predict(TRUE, recorded).torque, whole)


def test_a_late_prediction_has_times_of_its_own(recorded):
    late = limo.predict(TRUE, recorded, delay=0.1)
    np.testing.assert_allclose(late.time, recorded.time - 0.1, atol=1.01e-3)


class TestFollow:
    def test_an_arm_that_has_not_begun_is_put_where_the_motion_starts(self, planned, recorded):
        with limo.open_robot("mujoco", simulation=TRUE, seed=1) as robot:
            run = robot.follow(planned)
        np.testing.assert_array_equal(run.torque, recorded.torque)  # as with `initial_position`

    def test_an_arm_elsewhere_does_not_leap_there(self, planned):
        with limo.open_robot("virtual", simulation=TRUE) as robot:
            robot.receive()
            with pytest.raises(JointLimitError, match="first position"):
                robot.follow(planned)

    @pytest.mark.slow("plays a motion")
    def test_a_second_motion_has_to_go_on_from_the_first(self, planned):
        start = planned.trajectory.position[0]
        with limo.open_robot("virtual", simulation=TRUE) as robot:
            there = swing(start, 0.02)
            assert robot.follow(there).robot == "iiwa14"
            assert robot.follow(there).duration == pytest.approx(there.duration, abs=0.01)
            with pytest.raises(JointLimitError, match="first position"):
                robot.follow(swing(start + 0.3, 0.02))

    def test_the_recording_is_kept_where_it_is_asked_for(self, planned, tmp_path):
        path = tmp_path / "run.parquet"
        start = planned.trajectory.position[0]
        with limo.open_robot("virtual", simulation=TRUE) as robot:
            run = robot.follow(swing(start, 0.02), record=path)
        np.testing.assert_array_equal(limo.Recording.load(path).position, run.position)
        assert run.source == str(path)

    def test_what_slowed_the_motion_is_said(self, planned):
        start = planned.trajectory.position[0]
        with limo.open_robot("virtual", simulation=TRUE) as robot:
            run = robot.follow(swing(start, 2.0))
        assert any("limited by velocity" in item for item in run.warnings)

    def test_another_robots_motion_is_refused(self):
        wrong = limo.Trajectory(
            *(np.zeros((3, 7)) if k else np.arange(3.0) for k in range(4)), robot="panda"
        )
        with (
            limo.open_robot("virtual", simulation=TRUE) as robot,
            pytest.raises(ConfigError, match="planned for panda"),
        ):
            robot.follow(wrong)


def swing(start, amplitude):
    """Half a second there and half a second back."""
    t = np.linspace(0.0, 1.0, 251)
    motion = limo.Motion.from_positions(t, start + amplitude * np.sin(np.pi * t)[:, None] ** 4)
    return limo.Trajectory(motion.time, motion.position, motion.velocity, motion.acceleration)


@pytest.mark.slow("trains a model")
def test_a_model_is_trained_saved_loaded_and_evaluated(recorded, tmp_path):
    believed = TRUE.without_effects()
    model = limo.train(believed, [recorded])
    model.save(tmp_path / "model")
    loaded = limo.load_model(tmp_path / "model")
    found = limo.evaluate(loaded, recorded)
    assert found.hybrid.mse.mean() < 0.1 * found.rigid_body.mse.mean()
    found.save(tmp_path / "evaluation")
    assert (tmp_path / "evaluation" / "loops.png").stat().st_size > 1000
    assert "RMSE of the rigid body" in str(found)


def test_an_unknown_model_is_refused_by_name(recorded):
    with pytest.raises(ConfigError, match="no model is called 'mlp-7'; known: joint-physics"):
        limo.train(TRUE, [recorded], "mlp-7")


def test_a_bandwidth_is_not_of_a_model(recorded):
    class Trained:
        pass

    with pytest.raises(ConfigError, match="has the one it was trained with"):
        limo.predict(Trained(), recorded, bandwidth=5.0)


def test_a_diagnosis_of_nothing_and_a_filter_without_width_are_refused(recorded):
    with pytest.raises(RecordingError, match="no recording to diagnose"):
        limo.diagnose(TRUE, [])
    with pytest.raises(ConfigError, match="a bandwidth of 0 Hz, expected a positive number"):
        limo.train(TRUE, [recorded], bandwidth=0.0)


def test_a_nominal_has_what_its_file_states_beside_friction(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(arm_of(3), encoding="utf-8")
    stated = {(effect.name, effect.joint) for effect in limo.Simulation.load(path).effects}
    kept = {(effect.name, effect.joint) for effect in limo.nominal(path).effects}
    assert kept == {each for each in stated if each[0] in {"armature", "spring_load"}}
    assert {name for name, _ in kept} == {"armature", "spring_load"}


def test_what_was_not_found_is_said_to_be_0_where_the_file_states_another(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(arm_of(5, 2), encoding="utf-8")  # hinge0 states an armature
    time = np.arange(0, 20, 0.01)
    rate = 2 * np.pi * np.array([0.13, 0.21])
    phase = np.outer(time, rate)
    stated = limo.Simulation.load(path)
    rigid = replace(stated, effects=tuple(e for e in stated.effects if e.name == "spring_load"))
    motion = limo.Motion(time, np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase))
    noise = np.random.default_rng(0).normal(0, 0.02, phase.shape)
    recording = limo.Recording.from_arrays(time, motion.position, rigid.predict(motion) + noise)
    found = limo.identify(path, recording).simulation
    assert {e.joint: e.inertia for e in found.effects if e.name == "armature"} == {1: 0.0}
    exported = limo.export(found, "mjcf", tmp_path / "out")
    assert limo.RobotModel.load(exported.file).description.dynamics["hinge0"].armature == 0.0
