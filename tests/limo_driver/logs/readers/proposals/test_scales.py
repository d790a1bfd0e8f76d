"""Units that limits do not tell: parts of a rated torque, motors behind gears, slides in cm."""

import numpy as np
import pytest
from logged import arm, measured, numbered

from limo_driver.errors import ConfigError
from limo_driver.logs.readers.mapping import Channels
from limo_driver.logs.readers.proposals.proposal import propose
from limo_driver.logs.readers.table import table_of
from limo_driver.model import RobotModel

TIME, POSITION, _, TORQUE = measured()
RATED = arm().limits.torque
SLIDE = """<robot name="lift"><link name="base"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="car"/><axis xyz="0 0 1"/>
<limit lower="0" upper="{}" effort="4000" velocity="1"/></joint>
<link name="car"><inertial><mass value="20"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def asked(**columns):
    return propose(table_of({"t": TIME, **columns}), arm()).mapping.undecided


@pytest.mark.parametrize("scale", [100 / RATED, 300 / RATED, 1000 / RATED])
def test_parts_of_a_rated_torque_are_asked_about(scale):
    (question,) = asked(q=POSITION, tau=TORQUE * scale)
    assert question.startswith("torque: ")


@pytest.mark.parametrize("load", [1.0, 1.4])
def test_torques_in_newton_metres_are_not(load):
    assert asked(q=POSITION, tau=TORQUE * load) == ()


@pytest.mark.parametrize("name", ["tau{} [%]", "torque_percent_{}", "tau{} [‰]", "torque_{}_pct"])
def test_names_that_say_per_cent_ask_for_the_factor_of_each_joint(name):
    (question,) = asked(q=POSITION, **numbered(name, 100 * TORQUE / RATED))
    assert "of the rated torque: how many N m does one" in question
    assert "the weight of its bodies says" in question


def test_per_cent_without_a_factor_are_no_torque():
    table = table_of({"a": TIME})
    with pytest.raises(ConfigError, match="is in %; its `factor:` has to say how many N m one"):
        Channels(columns=("a",), unit=("%",)).read(table, "torque")
    read = Channels(columns=("a",), unit=("%",), factor=(1.76,)).read(table, "torque")
    np.testing.assert_allclose(read[:, 0], 1.76 * TIME)


@pytest.mark.parametrize("per_radian", [100 / (2 * np.pi), 160 / (2 * np.pi), 50.0, 4096 * 16.0])
@pytest.mark.parametrize("offset", [0.0, 0.4])
def test_motors_and_counters_behind_gears_are_not_read_as_degrees(per_radian, offset):
    questions = asked(q=(POSITION + offset) * per_radian, tau=TORQUE)
    assert any(text.startswith("position: ") for text in questions)


@pytest.mark.parametrize(("limit", "scale"), [(0.5, 1.0), (0.5, 100.0), (2.0, 1000.0)])
def test_slides_in_another_unit_than_metres_are_asked_about(tmp_path, limit, scale):
    path = tmp_path / "lift.urdf"
    path.write_text(SLIDE.format(limit), encoding="utf-8")
    lift = RobotModel(path)
    motion = limit * (0.5 + 0.4 * np.sin(0.4 * TIME))
    log = {"t": TIME, "lift_pos": scale * motion, "lift_force": 196.2 + 0 * TIME}
    found = propose(table_of(log), lift).mapping
    assert bool(found.undecided) == (scale != 1.0)
    assert all("m, cm or mm? lift (limits and speed allow" in text for text in found.undecided)
    rate = {"lift_vel [m/s]": np.gradient(motion, TIME)}
    unit = {1.0: "m", 100.0: "cm", 1000.0: "mm"}[scale]
    found = propose(table_of({**log, **rate}), lift).mapping
    assert (found.position.unit, found.undecided) == ((unit,), ())
    named = {f"lift_pos [{unit}]": scale * motion, "lift_force": log["lift_force"]}
    found = propose(table_of({"t": TIME, **named}), lift).mapping
    assert (found.position.unit, found.undecided) == ((unit,), ())
