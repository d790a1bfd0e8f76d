"""`limo identify` from file to file."""

from __future__ import annotations

import io
import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from lanes import sampled
from one_file import check_page, drawn, title_of
from rich.console import Console

import limo_driver as limo
from estimators.rigid_body.tables import joint_table
from limo_driver.app.cli import main
from limo_driver.physics import CoulombFriction, Simulation
from limo_driver.recordings.channels import Columns
from limo_driver.recordings.files.recording_file import write_columns
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

TRUE = Simulation("iiwa14", tuple(CoulombFriction(joint=j, tau_c=0.3 * j) for j in range(1, 8)))


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    t = np.arange(3000) / 100.0
    w = 2 * np.pi * np.array([0.31, 0.23, 0.37, 0.29, 0.41, 0.43, 0.47])
    angle = w * t[:, None] + np.arange(7)
    slow = 0.3 * angle
    motion = Motion(
        t,
        0.7 * np.sin(angle) + 0.5 * np.sin(slow),
        0.7 * w * np.cos(angle) + 0.15 * w * np.cos(slow),
        -0.7 * w**2 * np.sin(angle) - 0.045 * w**2 * np.sin(slow),
    )
    noise = 0.01 * np.random.default_rng(0).standard_normal((3000, 7))
    torque = TRUE.predict(motion) + noise
    torque[700, 3] = np.nan
    path = tmp_path_factory.mktemp("run") / "run.parquet"
    write_columns(Columns(t, motion.position, torque), path)  # as it was logged, hole and all
    return path


@pytest.fixture
def identify(tmp_path, monkeypatch, capsys):
    def run(path, *more):
        arguments = (path, "--robot", "iiwa14", "--out", tmp_path / "sim.yaml", *more)
        monkeypatch.setattr(sys, "argv", ["limo", "identify", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return (ended.value.code or 0, *capsys.readouterr())

    return run


def test_writes_a_simulation_that_holds_what_is_true(tmp_path, recording, identify):
    status, printed, notes = identify(recording, "--no-offset", "--no-armature")
    assert status == 0, notes
    assert "of 57 base parameters are known" in printed
    assert "1 row left out: a value is missing or not finite (row 700)" in notes
    found = Simulation.load(tmp_path / "sim.yaml")
    coulomb = {e.joint: e.tau_c for e in found.effects if isinstance(e, CoulombFriction)}
    assert coulomb == pytest.approx({j: 0.3 * j for j in range(1, 8)}, abs=0.03)
    page = (tmp_path / "sim.html").read_text()
    check_page(page)
    assert " of 57 base parameters are known to better than their size" in title_of(page)
    friction = next(c for c in drawn(page) if c["layout"]["yaxis"]["title"]["text"] == "N m")
    assert friction["data"][0]["y"] == pytest.approx([0.3 * j for j in range(1, 8)], abs=0.03)


def test_the_table_of_joints_fits_a_terminal(recording):
    found = limo.identify("iiwa14", [recording])
    viscous = [item for item in found.estimates if item.effect == "viscous_friction"]
    inertia = [
        replace(item, effect="armature", parameter="inertia", unit="kg m^2", value=-12.345)
        for item in viscous
    ]  # as a motion shows it that is fast enough
    found = replace(found, estimates=(*found.estimates, *inertia))
    console = Console(width=80, file=io.StringIO())
    console.print(joint_table(found))
    text = console.file.getvalue()
    assert {"armature", "viscous", "coulomb"} <= set(text.split())
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 80


def test_json_holds_the_findings(recording, identify):
    status, printed, _ = identify(recording, "--json", "--no-armature", "--bandwidth", "8")
    assert status == 0
    found = json.loads(printed)
    assert found["base_parameters"] == 64
    assert found["bandwidth"] == 8
    assert found["rows"][0]["used"] == 2999
    assert found["rows"][0]["left_out"] == {"a value is missing or not finite": [700]}
    assert 0 < found["inertia_tolerance"] <= 1
    assert len(found["effective_rows"]) == 7
    assert max(found["rmse"]["base_parameters"]) < 0.02
    assert {item["effect"] for item in found["joint_terms"]} == {
        "viscous_friction",
        "coulomb_friction",
        "torque_offset",
    }


@pytest.mark.slow("identifies a recording of an arm of seven joints")
def test_every_base_parameter_has_a_name_and_an_uncertainty(recording, identify):
    _, printed, _ = identify(recording, "--json", "--no-offset", "--no-armature")
    base = {item["name"]: item for item in json.loads(printed)["base"]}
    assert len(base) == 57
    assert base["my_3"]["combination"] == "my_3 - mz_4"
    for j in range(1, 8):
        coulomb = base[f"tau_c_{j}"]
        assert 0 < coulomb["deviation"] < 0.05
        assert abs(coulomb["value"] - 0.3 * j) < 5 * coulomb["deviation"] + 0.01
    # the links are those of the description, as far as the motion shows them
    far = [
        abs(item["value"] - item["nominal"]) / item["deviation"]
        for name, item in base.items()
        if name[0] in "mI"
    ]
    assert np.median(far) < 2
    _, table, _ = identify(recording, "--base")
    assert "my_3 - mz_4" in table


@sampled(
    ("more", "message"),
    [
        (("--robot", "robot9"), "'robot9' is neither built in"),
        (("--bandwidth", "70"), "a bandwidth of 70 Hz does not suit"),
        (("--weighting", "mood"), "weighting is 'mood', expected one of error"),
        (("--sign-width", "nan"), "--sign-width is nan, expected a number"),
        *(
            (("--bandwidth", value), f"bandwidth is {value} Hz, expected a number above 0 Hz")
            for value in ("0", "-3", "inf")
        ),
        *(
            (("--sign-width", value), f"sign width {value} rad/s: has to be above 0 and finite")
            for value in ("0", "-0.01")
        ),
        *(
            (("--inertia-tolerance", value), f"inertia tolerance {value}: has to lie in")
            for value in ("0", "-1", "1e-12")
        ),
    ],
    "identifies before it refuses",
    first=7,
)
def test_bad_input_is_one_line_and_status_2(tmp_path, recording, identify, more, message):
    status, _, notes = identify(recording, *more)
    assert status == 2
    assert message in notes
    assert notes.startswith("limo: ")
    assert notes.count("\n") == 1
    assert not (tmp_path / "sim.yaml").exists()


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("missing/sim.yaml", "there is no folder"),
        (".", "is a folder, expected a file"),
        ("/proc/sim.yaml", "cannot be written"),
    ],
)
def test_a_place_that_cannot_be_written_is_told_before_the_work(
    tmp_path, recording, identify, monkeypatch, out, message
):
    monkeypatch.setattr(Recording, "load", lambda _: pytest.fail("began to work"))
    status, _, notes = identify(recording, "--out", tmp_path / out)
    assert (status, notes.count("\n")) == (2, 1)
    assert message in notes


def test_the_same_samples_are_no_new_evidence(tmp_path, recording, identify):
    again = tmp_path / "again.parquet"
    again.write_bytes(recording.read_bytes())
    for second in (recording, again):
        status, _, notes = identify(recording, second)
        assert (status, notes.count("\n")) == (2, 1)
        assert f"{second}: holds the same samples as {recording}" in notes


@pytest.mark.parametrize(
    ("quantity", "message"),
    [("torque", "every torque is 0 N m"), ("position", "no joint moves")],
)
def test_a_recording_of_nothing_is_refused(tmp_path, recording, identify, quantity, message):
    whole = Recording.load(recording)
    arrays = {"position": whole.position, "torque": whole.torque}
    arrays[quantity] = np.zeros_like(arrays[quantity])
    path = tmp_path / "nothing.parquet"
    Recording(whole.time, **arrays).save(path)
    status, _, notes = identify(path)
    assert (status, notes.count("\n")) == (2, 1)
    assert f"{path}: {message}" in notes
