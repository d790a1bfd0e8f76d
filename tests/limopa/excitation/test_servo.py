"""Commands for position servos: within the limits, each joint alone and all together."""

from __future__ import annotations

import numpy as np
import pytest
from one_file import check_page

from limo_driver.app.cli.excite import command as excite
from limo_driver.errors import ConfigError, InfeasiblePathError
from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.model import RobotModel
from limopa import ServoRequest, Surroundings, excite_servos
from limopa.page import servo_page

FREE = Surroundings(self_collision=False, table_height=-5.0)
ARM = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
  <body><joint name="turn" axis="0 0 1" range="-2 2"/>
    <geom type="capsule" size=".02" fromto="0 0 0 0 0 .1" mass=".2"/>
    <body pos="0 0 .1"><joint name="lift" axis="0 1 0" range="-1.5 1.5"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .2 0 0" mass=".2"/>
    </body>
  </body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM)
    return path


@pytest.fixture(scope="module")
def arm(path):
    return RobotModel.load(path)


@pytest.fixture(scope="module")
def found(arm):
    return excite_servos(arm, ServoRequest(surroundings=FREE), seed=1)


def rows_for(found, kind):
    return [rows for rows in found.segments if rows.kind == kind]


def test_it_keeps_the_limits_and_ends_where_it_begins(arm, found):
    margin = FREE.joint_margin - 1e-9
    assert (found.command >= arm.limits.position_min + margin).all()
    assert (found.command <= arm.limits.position_max - margin).all()
    np.testing.assert_allclose(found.command[-1], found.command[0], atol=1e-9)
    assert found.repetitions[0].stop == found.repetitions[1].start
    assert found.repetitions[-1].stop == len(found.time)


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("kind", ["ramp", "steps", "quick", "creep"])
def test_each_joint_moves_alone(found, joint, kind):
    parts = rows_for(found, f"{kind} {joint}")
    assert len(parts) == len(found.repetitions)
    for part in parts:
        still = np.delete(found.command[part.start : part.stop], joint - 1, axis=1)
        assert np.ptp(still, axis=0).max() == 0.0
        assert np.ptp(found.command[part.start : part.stop, joint - 1]) > 0.05


def test_gravity_changes_along_the_ramp_of_a_joint_that_it_loads(arm, found):
    full = np.abs(arm.gravity_torque(np.zeros((1, 2)))[0, 1])  # the last link is level
    for part in rows_for(found, "ramp 2"):
        load = arm.gravity_torque(found.command[part.start : part.stop])[:, 1]
        assert np.ptp(load) > 0.5 * full


def test_all_but_steps_stays_below_the_speed(found):
    pace = np.abs(np.diff(found.command, axis=0)) * found.request.rate
    jumps = np.zeros(len(pace), dtype=bool)
    for part in found.segments:
        if part.kind.startswith("steps"):
            jumps[part.start - 1 : part.stop] = True
    assert pace[~jumps].max() < 1.01 * found.request.speed


def test_a_longer_motion_has_more_repetitions(arm, found):
    request = ServoRequest(duration=2.0 * found.duration, surroundings=FREE)
    assert len(excite_servos(arm, request, seed=1).repetitions) > len(found.repetitions)


def test_an_arm_that_cannot_move_is_told(arm):
    tight = Surroundings(self_collision=False, table_height=-5.0, joint_margin=1.45)
    with pytest.raises(InfeasiblePathError, match="joint 2 cannot move by"):
        excite_servos(arm, ServoRequest(surroundings=tight))


def test_the_page_says_what_shows_what(arm, found):
    text = servo_page(found, arm, "moves.csv", "arm.xml").html()
    check_page(text)
    assert "creeping reversals" in text
    assert "limo diagnose run.csv" in text


def test_the_command_writes_csv_page_and_episodes(commanded, path, tmp_path):
    out, folder = tmp_path / "moves.csv", tmp_path / "set"
    free = ("--no-self-collision", "--table-height", -5)
    result = commanded(excite)(
        "--for", "position-servo", "--robot", path, "--out", out, "--lerobot", folder,
        "--motors", "pan,tilt", *free,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "first pose" in result.output
    check_page((tmp_path / "moves.html").read_text())
    rows = np.loadtxt(out, delimiter=",", skiprows=1)
    episodes = read_table(folder)
    angle = episodes.columns["action.pan.pos"]
    np.testing.assert_allclose(np.radians(angle), rows[:, 1], atol=1e-5)
    assert episodes.columns["episode_index"].max() == 1


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (("--out", "moves.parquet"), "is no CSV"),
        (("--out", "moves.csv", "--motors", "one"), "--motors names 1, but .* has 2 joints"),
        (("--out", "moves.csv", "--picture", "a.png"), "is not drawn for servos"),
        (("--out", "moves.csv", "--harmonics", 3), "--harmonics is not for position servos"),
    ],
)
def test_what_cannot_be_is_told(commanded, path, tmp_path, monkeypatch, given, told):
    monkeypatch.chdir(tmp_path)
    result = commanded(excite)("--for", "position-servo", "--robot", path, *given)
    assert isinstance(result.exception, ConfigError)
    with pytest.raises(ConfigError, match=told):
        raise result.exception


def test_what_is_of_servos_alone_is_told(commanded, path, tmp_path):
    result = commanded(excite)("--robot", path, "--out", tmp_path / "a.parquet", "--motors", "a,b")
    assert isinstance(result.exception, ConfigError)
    assert str(result.exception) == "--motors is for position servos"
    assert not (tmp_path / "a.parquet").exists()
