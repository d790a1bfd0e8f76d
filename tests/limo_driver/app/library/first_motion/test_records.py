"""Which step may come next, by the records in a folder."""

import json
from dataclasses import replace

import pytest

from limo_driver.app.library.first_motion.records import (
    STEPS,
    Folder,
    Identity,
    description_digest,
)
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.physics import Payload, Simulation
from limo_driver.robot.registry import Examination

MINE = Identity("iiwa14", "d" * 64, "FRI 10.0.0.2, port 30200")


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


def passed(folder, *steps, identity=MINE):
    for step in steps:
        folder.keep(step, identity, Examination(), {})


def failed(folder, step):
    found = Examination()
    found.add("jitter", "3 measurements came late")
    found.add("tool-mass", "the arm carries 2 kg more than described")
    folder.keep(step, MINE, found, {})


def test_steps_are_offered_in_their_order(folder):
    for step in STEPS:
        assert folder.next_step(MINE) == step
        folder.require_before(step, MINE)
        passed(folder, step)
    assert folder.next_step(MINE) == STEPS[-1]


@pytest.mark.parametrize("step", STEPS[1:])
def test_a_step_is_refused_while_the_one_before_was_skipped(folder, step):
    passed(folder, *STEPS[: STEPS.index(step) - 1])
    with pytest.raises(ConfigError, match=r"and nothing moves: step .* was skipped") as refused:
        folder.require_before(step, MINE)
    assert str(refused.value).count("\n") == 0
    assert f"`step` {STEPS[STEPS.index(step) - 1]} first" in str(refused.value)


def test_a_step_is_refused_after_one_that_failed_and_says_of_what(folder):
    passed(folder, "link")
    failed(folder, "receive")
    with pytest.raises(ConfigError, match=r"step 2 \(receive only\) failed: 3 .*; the arm carries"):
        folder.require_before("shadow", MINE)
    assert folder.next_step(MINE) == "receive"


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (replace(MINE, description="e" * 64), "another description of the arm"),
        (replace(MINE, address="FRI 10.0.0.3, port 30200"), "at another address: FRI 10.0.0.2"),
    ],
)
def test_records_of_another_arm_do_not_count(folder, other, said):
    passed(folder, "link", "receive")
    with pytest.raises(ConfigError, match=said):
        folder.require_before("shadow", other)
    assert folder.next_step(other) == "link"


def test_who_repeats_a_step_repeats_those_after_it(folder):
    passed(folder, "link", "receive", "shadow")
    found = Examination(figures={"cycles": 2})
    folder.keep("receive", MINE, found, {"duration": 10.0})
    assert folder.why_not("receive", MINE) == ""
    assert "before step 2 (receive only) was repeated" in folder.why_not("shadow", MINE)


def test_a_step_that_is_begun_again_has_not_passed_until_it_ends(folder):
    passed(folder, "link", "receive")
    folder.begin("receive")
    assert folder.next_step(MINE) == "receive"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is no record of a step"),
        ("[1]", "is no record of the step link"),
        (
            json.dumps({"format": "limo first motion", "step": "receive"}),
            "is no record of the step",
        ),
        (
            json.dumps({"format": "limo first motion", "step": "link", "version": 9}),
            "is of version 9 of its format, expected 1",
        ),
    ],
)
def test_records_that_cannot_be_read_are_refused_by_name(folder, text, said):
    folder.file("link", ".json").write_text(text)
    with pytest.raises(ConfigError, match=said) as refused:
        folder.next_step(MINE)
    assert "1_link.json" in str(refused.value)


def test_a_record_that_was_edited_breaks_those_after_it(folder):
    passed(folder, "link", "receive")
    path = folder.file("link", ".json")
    path.write_text(path.read_text().replace("passed", "passed "))
    assert folder.next_step(MINE) == "link"


def test_descriptions_are_told_apart_by_tool_mounting_and_file():
    arm = RobotModel.load("iiwa14")
    laden = Simulation("iiwa14", effects=(Payload(mass=1.0, com=(0.0, 0.0, 0.1)),)).body
    turned = arm.with_gravity((0.0, 9.81, 0.0))
    known = {description_digest(each) for each in (arm, laden, turned)}
    assert len(known) == 3
    assert description_digest(RobotModel.load("iiwa14")) in known
