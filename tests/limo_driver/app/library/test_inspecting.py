"""`limo inspect`: one of two arms, mappings that are there already, and mappings that are tried."""

import json
import re

import numpy as np
import pytest
from lanes import sampled
from logged import arm, measured, numbered, written

import limo_driver as limo
from limo_driver.errors import ConfigError, RecordingError
from limopa import PlanRequest
from limopa.page import plan_page

TIME, POSITION, _, TORQUE = (values[:1500] for values in measured())
_, OTHER, _, ITS = (values[1500:] for values in measured())


def one_arm():
    return {
        "t_ms": 1e3 * TIME,
        **numbered("q{}", np.rad2deg(POSITION)),
        **numbered("tau{}", TORQUE),
    }


def two_arms():
    left = numbered("left_q{}", POSITION) | numbered("left_tau{}", TORQUE)
    right = numbered("right_q{}", OTHER) | numbered("right_tau{}", ITS)
    return {"t": TIME, **left, **right}


INSPECT = ("inspect", "log.csv", "--robot", "iiwa14")


def test_a_pattern_chooses_one_of_two_arms(run, tmp_path):
    written(two_arms(), tmp_path / "log.csv")
    asked = run(*INSPECT)[1]
    assert "an inspection with --columns as '*left*' is of the first" in asked
    assert "next: answer each of the 2 questions" in asked
    status, said, _ = run(*INSPECT, "--columns", "right_*")
    assert status == 0
    assert "wrote mapping.yaml" in said  # over the one in which nobody had answered
    assert "left out: left_q0" in said
    recording = limo.read(tmp_path / "log.csv", "iiwa14", tmp_path / "mapping.yaml")
    np.testing.assert_allclose(recording.position, OTHER, atol=1e-7)
    kept = run(*INSPECT, "--columns", "left_*")[1]
    assert "kept mapping.yaml, which is there and reads otherwise (position has columns" in kept
    assert "right_q0 … right_q6, not left_q0 … left_q6" in kept


def test_a_part_of_a_name_can_be_meant():
    log = {"t": TIME, "position[right]": POSITION[:, 0]}
    log |= {f"position.{side}_joint{j + 1}": POSITION[:, j] for side in "ab" for j in range(7)}
    found = limo.inspect(log, "iiwa14", columns="b_*")
    assert found.mapping.position.columns[0] == "position.b_joint1"
    assert {"position.a_joint1", "position[right]"} <= set(found.mapping.left_out)
    assert len(limo.inspect(log, "iiwa14", columns="a_joint[1-3],a_*,t").mapping.left_out) == 8


def test_a_pattern_that_no_column_matches_is_refused_with_what_is_there(run, tmp_path):
    written(two_arms(), tmp_path / "log.csv")
    status, _, errors = run(*INSPECT, "--columns", "left_*,up_*")
    assert status == 2
    assert "--columns: none matches 'up_*'; it has t, left_q0" in errors
    with pytest.raises(RecordingError, match="none matches"):
        limo.inspect(two_arms(), "iiwa14", columns="middle*")


def test_two_readings_of_one_arm_are_asked_without_a_pattern():
    log = {"t": TIME, "q": POSITION, "theta": POSITION + 0.01, "tau": TORQUE}
    assert not any("`columns`" in question for question in limo.inspect(log, "iiwa14").questions)


@pytest.mark.slow("inspects a log again and again")
def test_an_answered_mapping_is_tried(run, tmp_path):
    written(one_arm(), tmp_path / "log.csv")
    run(*INSPECT)
    before = (tmp_path / "mapping.yaml").read_bytes()
    status, said, _ = run(*INSPECT, "--mapping", "mapping.yaml")
    assert status == 0
    assert "deg  the mapping says so" in said
    assert "telemetry: sampled at 250 Hz" in said
    assert "next: limo diagnose log.csv --robot iiwa14 --mapping mapping.yaml" in said
    assert (tmp_path / "mapping.yaml").read_bytes() == before
    assert json.loads(run(*INSPECT, "--mapping", "mapping.yaml", "--json")[1])["kept"] is True
    text = before.decode().replace("unit: deg", "unit: rad")
    (tmp_path / "mapping.yaml").write_text(text)
    status, _, errors = run(*INSPECT, "--mapping", "mapping.yaml")
    assert status == 2
    assert "is it in degrees" in errors
    signs = before.decode().replace("unit: N m", "unit: N m\n  sign: -1")
    (tmp_path / "mapping.yaml").write_text(signs)
    assert (
        "undecided: read as proposed it is refused" in run(*INSPECT, "--mapping", "mapping.yaml")[1]
    )


def test_a_mapping_that_names_its_columns_takes_no_pattern():
    mapping = limo.inspect(one_arm(), "iiwa14").mapping
    with pytest.raises(ConfigError, match="`columns` and `mapping` are both given"):
        limo.inspect(one_arm(), "iiwa14", columns="q*", mapping=mapping)
    with pytest.raises(RecordingError, match="has no column 't_ms'"):
        limo.inspect(two_arms(), "iiwa14", mapping=mapping)


def of_other_columns():
    return limo.inspect(two_arms(), "iiwa14", columns="left_*").mapping.as_file


def of_other_joints():
    return limo.inspect(one_arm(), "iiwa14").mapping.as_file.replace("joint7", "j7")


@sampled(
    ("there", "why"),
    [
        (of_other_columns, "it reads t, left_q0"),
        (of_other_joints, "of the joints j7"),
        (lambda: "robot: [", ""),
        (lambda: "topics: {a: b}", ""),
    ],
    "inspects a log each",
    ids=["other columns", "other joints", "damaged", "something else"],
)
def test_a_mapping_of_something_else_is_neither_proposed_nor_written_over(
    run, tmp_path, there, why
):
    written(one_arm(), tmp_path / "log.csv")
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(there())
    before = mapping.read_bytes()
    for _ in range(2):
        status, said, _ = run(*INSPECT)
        assert status == 0
        assert "kept mapping.yaml, which is no mapping of this log: " in said
        assert why in said
        assert "wrote log.mapping.yaml" in said
        assert "--mapping log.mapping.yaml --out diagnosis" in said
    assert mapping.read_bytes() == before
    (tmp_path / "log.mapping.yaml").write_bytes(before)
    status, _, errors = run(*INSPECT)
    assert status == 2
    assert "name another file by --out" in errors


@pytest.mark.slow("inspects a log again and again")
def test_answers_that_are_open_still_are_asked_for_again(run, tmp_path):
    written(two_arms(), tmp_path / "log.csv")
    run(*INSPECT)
    text = (tmp_path / "mapping.yaml").read_text().replace("unit: rad", "unit: [rad]")
    (tmp_path / "mapping.yaml").write_text(text)  # somebody has begun
    said = run(*INSPECT)[1]
    assert "kept mapping.yaml" in said
    assert "next: answer each of the 2 questions under `undecided:` in mapping.yaml" in said
    assert (tmp_path / "mapping.yaml").read_text() == text


def test_an_arm_without_masses_is_inspected_and_planned_but_not_diagnosed(tmp_path):
    text = re.sub("<inertial>.*?</inertial>", "", arm().urdf.read_text(), flags=re.DOTALL)
    (tmp_path / "light.urdf").write_text(text)
    light = limo.RobotModel.load(tmp_path / "light.urdf")
    found = limo.inspect({"t": TIME, "q_rad": POSITION, "tau_nm": TORQUE}, light)
    assert found.recording is not None
    assert found.mapping.undecided == ()
    assert "have no mass" in str(found)
    planned = limo.plan(light, PlanRequest(scaffolds=1), seed=1)
    plan_page(planned, light, "motion", "light.urdf").save(tmp_path / "plan.html")
    with pytest.raises(ConfigError, match=r"7 links that move, link1, .* have no mass"):
        limo.nominal(str(tmp_path / "light.urdf"))


@pytest.mark.parametrize(("stated", "option"), [('frictionloss="0.4"', "--sim"), ("", "--robot")])
def test_what_an_mjcf_states_of_friction_is_believed_by_what_is_proposed(
    run, tmp_path, stated, option
):
    (tmp_path / "arm.xml").write_text(
        f'<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" {stated}/>'
        '<geom type="capsule" fromto="0 0 0 0 0 .4" size=".05" mass="4"/></body></worldbody>'
        "</mujoco>"
    )
    angle = np.sin(TIME)
    log = {"time": TIME, "q1_rad": angle, "tau1_Nm": -8 * np.sin(angle) + 0.1 * np.cos(TIME)}
    written(log, tmp_path / "log.csv")
    _, said, _ = run("inspect", "log.csv", "--robot", "arm.xml")
    assert f"next: limo diagnose log.csv {option} arm.xml --mapping mapping.yaml" in said


def filled(run, tmp_path, text):
    """What an inspection says of a mapping with this text."""
    (tmp_path / "mapping.yaml").write_text(text)
    return run(*INSPECT, "--mapping", "mapping.yaml")[2]


def test_a_log_of_which_nothing_is_known_makes_a_mapping_to_be_filled_in(run, tmp_path):
    odd = {"t": TIME, "alpha": POSITION[:, 0], "beta": TORQUE[:, 0]}
    written(odd, tmp_path / "log.csv")
    status, _, errors = run(*INSPECT)
    assert status == 2
    assert "wrote mapping.yaml, a mapping to be filled in: name the columns there" in errors
    text = (tmp_path / "mapping.yaml").read_text()
    assert "[t, alpha, beta]" in text
    assert "time: has neither `columns:`" in run(*INSPECT, "--mapping", "mapping.yaml")[2]
    for quantity in ("time", "position", "torque"):
        names = "[t]" if quantity == "time" else f"[{', '.join(['alpha'] * 7)}]"
        text = text.replace(f"{quantity}: {{columns: []", f"{quantity}: {{columns: {names}")
    assert "velocity: has 0 columns" in filled(run, tmp_path, text)
    kept = [line for line in text.splitlines() if not line.startswith(("velocity", "command"))]
    assert "column alpha stands for two" in filled(run, tmp_path, "\n".join(kept))
    assert "kept mapping.yaml, which is there" in run(*INSPECT)[2]


def test_a_log_without_torque_says_where_to_name_one(run, tmp_path):
    written({"t": TIME, **numbered("q{}_rad", POSITION)}, tmp_path / "log.csv")
    said = run(*INSPECT)[1]
    assert "under `torque:` or `command:` in mapping.yaml" in said
