"""Small logs as strangers bring them, each with the right answer: read right, or asked about."""

import os
from pathlib import Path

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.errors import ConfigError

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
LOGS = DATA / "stranger_logs"
SIX_AXES = DATA / "ur10e" / "ur10e.urdf"

pytestmark = pytest.mark.skipif(
    not LOGS.is_dir(), reason=f"no logs of strangers in {DATA}; name their folder in LIMO_DATA"
)


def test_a_clock_that_was_set_back_is_cut_and_every_message_kept():
    read = [
        limo.read(LOGS / "clock_step_back" / name, LOGS / "clock_step_back" / "arm.urdf")
        for name in ("clock_step_back", "no_step")
    ]
    np.testing.assert_array_equal(read[0].position, read[1].position)
    assert [part.start for part in read[0].segments] == [0, 2001]
    assert any("clock was set back by 0.5 s at row 2001" in text for text in read[0].warnings)
    speeds = [np.abs(r.motion(10.0).velocity[~r.edges(10.0)]).max() for r in read]
    assert speeds[0] == pytest.approx(speeds[1], rel=0.02)
    assert not read[1].warnings[1:]


def test_poses_held_one_after_the_other_are_in_radians():
    found = limo.inspect(LOGS / "static_poses_read_as_deg" / "log.csv", "iiwa14")
    assert found.mapping.position.unit == ("rad",)
    assert any("are currents" in question for question in found.questions)


def test_rows_may_end_in_a_separator_that_the_names_lack():
    recording = limo.read(LOGS / "csv_trailing_separator" / "log.csv", SIX_AXES)
    assert (len(recording), recording.n) == (1000, 6)
    assert recording.position[0, 1] == pytest.approx(np.deg2rad(-25.3635))
    assert recording.torque[0, 5] == pytest.approx(2.2216)


def test_columns_in_amperes_are_currents_whose_factor_is_asked_for():
    log = LOGS / "currents_named_by_unit" / "log.csv"
    found = limo.inspect(log, SIX_AXES)
    assert found.mapping.torque.columns == tuple(f"c{j} (A)" for j in range(1, 7))
    assert found.mapping.torque.unit == ("A",)
    (question,) = found.questions
    assert "how many N m does one A make at each joint (`factor:`)" in question
    with pytest.raises(ConfigError, match="how many N m does one A make"):
        limo.read(log, SIX_AXES)


@pytest.mark.slow("a whole diagnosis")
def test_a_damper_has_play_friction_and_a_stiffness_and_nothing_else():
    folder = LOGS / "backlash_of_a_damper"
    slide = folder / "slide.urdf"
    found = limo.diagnose(slide, limo.read(folder / "log.csv", slide)).verdict
    (play,) = found.findings
    assert (play.effect, play.joints) == ("backlash", (1,))
    values = {name: known.value for name, known in play.parameters.items()}
    assert values["gap"] == pytest.approx(0.005, rel=0.02)
    assert values["drag"] == pytest.approx(10e3, rel=0.02)
    assert values["drag"] / values["width"] == pytest.approx(5e6, rel=0.02)  # N/m
    assert play.parameters["drag"].unit == "N"
    (dry,) = [x for x in found.identified if x.effect == "coulomb_friction"]
    assert dry.parameters["tau_c"].value == pytest.approx(10e3, rel=0.02)
    assert not found.unexplained_joints


@pytest.mark.slow("two diagnoses")
def test_a_contact_that_ends_at_rest_is_found_and_none_without_it():
    folder = LOGS / "contact_then_rest"
    arm = folder / "arm.urdf"
    contact, free = (
        limo.diagnose(arm, limo.read(folder / name, arm, mapping=folder / "map.yaml")).verdict
        for name in ("log.csv", "free.csv")
    )
    (found,) = [item for item in contact.findings if item.effect == "external_contact"]
    assert found.joints == (1,)
    assert found.where.time[0][0] == pytest.approx(30.0, abs=0.5)
    assert not [item for item in free.findings if item.effect == "external_contact"]
