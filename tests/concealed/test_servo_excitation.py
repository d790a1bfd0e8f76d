"""From nothing to a report: plan commands, play them on a concealed arm, name what is hidden."""

import json

import numpy as np
import pytest
import servo_cases
import servo_plant

from limo_driver.app.cli.diagnose import command as diagnose
from limo_driver.app.cli.excite import command as excite

EVERY = 0.02  # [s] between two commands


@pytest.mark.slow("plans, plays and diagnoses four minutes of motion: half a minute each")
@pytest.mark.parametrize("hidden", ["backlash", "payload"])
def test_commands_that_are_played_show_what_is_hidden(hidden, commanded, tmp_path):
    (tmp_path / "hobby.xml").write_text(servo_plant.mjcf(servo_plant.hobby_arm()))
    moves = tmp_path / "moves.csv"
    free = ("--no-self-collision", "--table-height", -1)
    planned = commanded(excite)(
        "--for", "position-servo", "--robot", tmp_path / "hobby.xml", "--out", moves, *free
    )
    assert planned.exit_code == 0, planned.output

    commands = np.loadtxt(moves, delimiter=",", skiprows=1)[:, 1:]
    case = servo_cases.make(3, (hidden,), rate=50.0, commanded=(EVERY, commands))
    sim, recordings = case.write(tmp_path)
    found = commanded(diagnose)(*recordings, "--sim", sim, "--out", tmp_path / "found")
    assert found.exit_code == 0, found.output

    verdict = json.loads((tmp_path / "found" / "verdict.json").read_text())
    named = [(item["effect"], item["joints"]) for item in verdict["findings"]]
    assert named == [(x.effect, list(x.joints)) for x in case.hidden]
    assert verdict["fit"]["unit"] == "rad"
