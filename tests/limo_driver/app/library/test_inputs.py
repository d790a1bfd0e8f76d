"""What functions of the library take, and what they say of all else."""

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.app.library.inputs import recordings_of
from limo_driver.errors import ConfigError, PathError, RecordingError, ShapeError

T = np.arange(0, 4, 0.004)
POSITION = 0.5 + 0.3 * np.sin(np.pi * T)[:, None] * np.ones(7)
ARM = limo.RobotModel.load("iiwa14")
SIM = limo.Simulation("iiwa14")


@pytest.fixture(scope="module")
def recording():
    return limo.Recording.from_arrays(T, POSITION, ARM.gravity_torque(POSITION))


@pytest.fixture
def saved(recording, tmp_path):
    recording.save(tmp_path / "run.parquet")
    return tmp_path / "run.parquet"


@pytest.fixture
def trajectory():
    motion = limo.Motion.from_positions(T, 0.1 * POSITION)
    return limo.Trajectory(T, motion.position, motion.velocity, motion.acceleration, robot="iiwa14")


class TestRecordings:
    def test_one_or_several_themselves_or_by_file_are_taken(self, recording, saved):
        for given in (recording, saved, str(saved), [recording], (r for r in [saved]), {saved: 1}):
            (found,) = recordings_of(given)
            np.testing.assert_array_equal(found.torque, recording.torque)

    @pytest.mark.parametrize(
        ("given", "said"),
        [
            (5, "`recordings` is an int, expected a Recording, the path of one, or an iterable"),
            (None, "`recordings` is None, expected a Recording"),
            (np.zeros(3), "`recordings` holds a float64, expected a Recording"),
            ([{}], "`recordings` holds a dict, expected a Recording"),
        ],
    )
    def test_what_is_none_is_named(self, given, said):
        for function in (limo.diagnose, limo.train):
            with pytest.raises(ConfigError, match=said):
                function(SIM, given)
        with pytest.raises(ConfigError, match=said):
            limo.identify(ARM, given)

    def test_a_file_that_is_not_there_is_said_by_every_function(self):
        for function in (limo.diagnose, limo.train, limo.predict):
            with pytest.raises(RecordingError, match=r"none\.csv: no such file"):
                function(SIM, "none.csv")


def test_simulation_and_recording_may_be_files(recording, saved, tmp_path):
    SIM.save(tmp_path / "sim.yaml")
    known = limo.predict(SIM, recording).torque
    np.testing.assert_array_equal(limo.predict(tmp_path / "sim.yaml", saved).torque, known)
    np.testing.assert_array_equal(limo.predict(str(tmp_path / "sim.yaml"), recording).torque, known)


def test_a_simulation_does_not_know_its_errors(recording):
    assert np.isnan(limo.predict(SIM, recording).std).all()
    assert "NaN" in limo.predict.__doc__


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda r: limo.identify(7, r), "`robot` is an int, expected a RobotModel"),
        (lambda r: limo.identify(ARM, r, rows=8.0), "`rows` is a float, expected a Rows"),
        (lambda r: limo.identify(ARM, r, terms=8.0), "`terms` is a float, expected a JointTerms"),
        (lambda r: limo.diagnose({}, r), "`simulation` is a dict, expected a Simulation"),
        (lambda r: limo.train(SIM, r, "mlp7", settings={"epochs": 3}), "`settings` is a dict"),
        (lambda r: limo.predict(SIM, [r]), "`recording` is a list, expected one Recording"),
        (lambda r: limo.predict(3.0, r), "`model` is a float, expected a fitted model"),
        (lambda r: limo.evaluate(SIM, r), "`model` is a simulation, and `against` is missing"),
        (
            lambda _: limo.run("virtual", POSITION),
            "`trajectory` is of type ndarray, expected a Tra",
        ),
        (lambda _: limo.plan("iiwa14", limo.ExcitationRequest()), "`request` is an ExcitationReq"),
        (lambda _: limo.excite("iiwa14", limo.PlanRequest()), "`request` is a PlanRequest, expec"),
        (lambda _: limo.plan("iiwa14", seed=-1), "seed is -1, expected a whole number of 0 or"),
        (lambda _: limo.excite("iiwa14", seed=0.5), "seed is 0.5, expected a whole number"),
        (lambda _: limo.open_robot("virtual", robot="iiwa14", seed="x"), "seed is 'x', expected"),
        (lambda _: limo.open_robot("mujoco", robot="iiwa14", seed=-3), "seed is -3, expected"),
    ],
)
def test_arguments_of_another_type_are_named(recording, call, said):
    with pytest.raises(ConfigError, match=said):
        call(recording)


class TestArrays:
    @pytest.mark.parametrize("position", [np.zeros(6), np.zeros((1, 7)), 0.0])
    @pytest.mark.parametrize(
        "name", ["mass_matrix", "flange_pose", "flange_jacobian", "joint_poses"]
    )
    def test_a_position_is_of_all_joints(self, name, position):
        with pytest.raises(ShapeError, match=r"position has shape .*, expected \(7,\)"):
            getattr(ARM, name)(position)

    @pytest.mark.parametrize("name", ["mass_matrix", "flange_pose", "flange_position"])
    def test_a_position_is_of_numbers(self, name):
        with pytest.raises(ConfigError, match="position is no array of real numbers: list"):
            getattr(ARM, name)([0, 0, 0, "x", 0, 0, 0])

    def test_positions_are_of_all_joints(self):
        for call in (ARM.flange_position, ARM.gravity_torque, lambda q: ARM.inertia_of(q, 0)):
            with pytest.raises(ShapeError, match=r"position has shape \(3, 6\), expected \(T, 7\)"):
                call(np.zeros((3, 6)))
        with pytest.raises(ConfigError, match="column 7 does not exist, expected 0 to 6"):
            ARM.inertia_of(np.zeros((3, 7)), 7)

    def test_lists_are_as_good_as_arrays(self):
        still = np.zeros((2, 7))
        np.testing.assert_array_equal(
            ARM.inverse_dynamics(*3 * [still.tolist()]), ARM.inverse_dynamics(*3 * [still])
        )

    @pytest.mark.parametrize(
        ("gravity", "error", "said"),
        [
            ((0.0, 9.81), ShapeError, r"gravity has shape \(2,\), expected \(3,\)"),
            ((0.0, 0.0, np.nan), ConfigError, "expected finite numbers"),
            ("down", ConfigError, "gravity is no array of real numbers: str"),
        ],
    )
    def test_a_gravity_is_a_vector(self, gravity, error, said):
        with pytest.raises(error, match=said):
            ARM.with_gravity(gravity)

    @pytest.mark.parametrize("period", [0.0, -1.0, np.nan])
    def test_a_sample_period_is_above_zero(self, trajectory, period):
        with pytest.raises(ConfigError, match=r"a sample period of .* s, expected above 0"):
            trajectory.resample(period)

    @pytest.mark.parametrize(
        ("time", "error", "said"),
        [
            (np.zeros((2, 2)), ShapeError, r"time has shape \(2, 2\), expected \(T,\)"),
            ([0.0, np.nan], PathError, "time nan to nan s is outside the trajectory"),
            ([0.0, 99.0, 1.0], PathError, "time 0 to 99 s is outside the trajectory"),
            ("now", ConfigError, "time is no array of real numbers: str"),
        ],
    )
    def test_times_are_within_the_trajectory(self, trajectory, time, error, said):
        with pytest.raises(error, match=said):
            trajectory.evaluate(time)

    def test_what_is_filtered_has_a_row_for_each_sample(self, recording):
        for values in (np.zeros(len(recording)), np.zeros((3, 7)), 1.0):
            with pytest.raises(ShapeError, match=r"values has shape .*, expected \(1000, k\)"):
                recording.filtered(values, 10.0)
        with pytest.raises(RecordingError, match="values is no array of real numbers"):
            recording.filtered("torque", 10.0)


class TestFiles:
    @pytest.mark.parametrize("name", ["x.csv", "x.txt", "x.mcap", "x.parquet.gz"])
    def test_an_ending_of_another_format_is_refused_before_the_work(
        self, recording, trajectory, tmp_path, name
    ):
        said = "cannot be written: Parquet is written, and its name ends in .*; expected .parquet"
        path = tmp_path / name
        for call in (
            lambda: recording.save(path),
            lambda: trajectory.save(path),
            lambda: limo.run("virtual", trajectory, record=path),
        ):
            with pytest.raises(ConfigError, match=said):
                call()
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("name", ["x.parquet", "x.PQ", "x"])
    def test_others_are_written(self, recording, tmp_path, name):
        recording.save(tmp_path / name)
        assert len(limo.Recording.load(tmp_path / name)) == len(recording)

    @pytest.mark.slow("plays a motion")
    def test_a_trajectory_may_be_a_file(self, trajectory, tmp_path):
        trajectory.save(tmp_path / "motion.parquet")
        with limo.open_robot("virtual", robot="iiwa14") as robot:
            run = robot.follow(str(tmp_path / "motion.parquet"))
        assert run.duration == pytest.approx(trajectory.duration, abs=0.01)


def test_an_open_robot_says_what_it_is():
    with limo.open_robot("virtual", robot="iiwa14") as robot:
        assert repr(robot) == "<VirtualRobot: iiwa14, 7 joints at 1000 Hz, open>"
    assert repr(robot).endswith("closed>")
    assert repr(ARM) == "<RobotModel: iiwa14, 7 joints, 25.61 kg that move>"
