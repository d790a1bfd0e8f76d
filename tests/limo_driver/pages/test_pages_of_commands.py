"""Every command's page can be used by everybody, at any width, by day and by night."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from audit import violations
from browser import browser, program
from ports import free_port

from limo_driver.app.library.whole.explaining import whole_page
from limo_driver.app.library.whole.processes import ProvenWire
from limo_driver.app.library.whole.proving import Proof, Step

pytestmark = [
    pytest.mark.slow("plans, records, learns, and starts a browser"),
    pytest.mark.skipif(program() is None, reason="no Chromium is installed on this machine"),
]
SHORT = "--duration 10 --harmonics 2 --starts 1 --iterations 0 --rate 50"
COMMANDS = f"""
plan --scaffolds 1 --seed 1 --out limo.traj.parquet
excite {SHORT} --out excite.parquet
run --backend mujoco --trajectory limo.traj.parquet --record run.parquet
inspect run.parquet --robot iiwa14 --out mapping.yaml --page log.html
identify run.parquet --robot iiwa14 --out sim.yaml
train run.parquet --sim sim.yaml --model joint-physics --out model
evaluate run.parquet --model model --sim sim.yaml --out evaluation
"""
PAGES = (
    "limo.traj.html",
    "excite.html",
    "log.html",
    "sim.html",
    "model/report.html",
    "evaluation/report.html",
    "doctor/1_link.html",
    "whole.html",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder in which each command was run once, and the page of the whole."""
    own, limo = tmp_path_factory.mktemp("pages"), Path(sys.executable).parent / "limo"
    for line in COMMANDS.strip().splitlines():
        subprocess.run([limo, *line.split()], cwd=own, check=True, capture_output=True)
    nobody = ("--port", str(free_port()), "--robot", "iiwa14", "--seconds", "1", "--out", "doctor")
    subprocess.run([limo, "doctor", "fri", *nobody], cwd=own, check=False, capture_output=True)
    felt = np.array([0, 4_000_000]), np.array([[0.1, np.nan], [0.2, 0.3]])
    steps = [Step("A step", "0.7 N m", "0.5 N m", held) for held in (True, False)]
    whole_page(Proof(ProvenWire("MuJoCo", "mujoco"), steps, [felt], seconds=3.0)).save(
        own / "whole.html"
    )
    return own


@pytest.fixture(scope="module")
def tab():
    with browser() as opened:
        yield opened


@pytest.mark.parametrize("page", PAGES)
def test_everybody_can_use_it(folder, tab, page):
    for width, dark in ((1400, False), (390, True)):
        assert violations(tab, (folder / page).as_uri(), width, dark=dark) == []
    assert tab.errors == []
