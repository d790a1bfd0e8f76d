"""What limo 0.1.0 wrote is read; what a newer one wrote is refused by naming that one.

`written_by_0_1_0` holds a file of each format as that version left it, of an arm of two joints:
plan, recording, a log that kill -9 cut off, bag, mapping, diagnosis, two models and a store.
`expected.npz` is what its models said of each fiftieth row.
"""

from __future__ import annotations

import json
from pathlib import Path
from shutil import copytree

import numpy as np
import pyarrow.parquet as pq
import pytest

import limo_driver as limo
from estimators.diagnosis.reading import verdict_in
from estimators.service.store.store import ModelStore
from limo_driver.runtime import written_by

OLD = Path(__file__).parent / "written_by_0_1_0"
ROWS = 800


@pytest.fixture
def old(tmp_path: Path) -> Path:
    return copytree(OLD, tmp_path / "old")


def test_recording_and_trajectory(old: Path) -> None:
    recording = limo.read(old / "recording.parquet", old / "arm.xml")
    planned = limo.Trajectory.load(old / "trajectory.parquet")
    assert len(recording) == len(planned) == ROWS
    np.testing.assert_array_equal(recording.position, planned.position)
    assert not recording.warnings


def test_log_that_was_cut_off(old: Path) -> None:
    recording = limo.read(old / "cut.parquet.partial")
    whole = limo.read(old / "recording.parquet")
    assert len(recording) == 300
    np.testing.assert_array_equal(recording.torque, whole.torque[:300])
    assert "lacks its end" in recording.warnings[0]


def test_bag(old: Path) -> None:
    recording = limo.read(old / "recording.mcap", old / "arm.xml")
    whole = limo.read(old / "recording.parquet")
    np.testing.assert_allclose(recording.torque, whole.torque, atol=1e-9)


def test_mapping(old: Path) -> None:
    recording = limo.read(old / "log.csv", old / "arm.xml", old / "mapping.yaml")
    whole = limo.read(old / "recording.parquet")
    np.testing.assert_allclose(recording.position, whole.position, atol=1e-5)
    np.testing.assert_allclose(recording.torque, whole.torque, atol=1e-4)


def test_simulation(old: Path) -> None:
    planned = limo.Trajectory.load(old / "trajectory.parquet")
    motion = limo.Motion(planned.time, planned.position, planned.velocity, planned.acceleration)
    torque = limo.Simulation.load(old / "given.yaml").predict(motion)
    np.testing.assert_allclose(torque[::50], np.load(old / "expected.npz")["given"], rtol=1e-9)


def test_verdict(old: Path) -> None:
    found = verdict_in(old)
    assert found.verdict == "explained"
    assert [(x.effect, x.joints) for x in found.findings] == [("coulomb_friction", (1,))]
    assert found.findings[0].parameters["tau_c"].value == pytest.approx(1.0989, abs=1e-4)


@pytest.mark.parametrize("name", ["joint_physics", "network"])
def test_model_estimates_as_it_did(old: Path, name: str) -> None:
    torque = limo.predict(old / name, old / "recording.parquet").torque
    np.testing.assert_allclose(torque[::50], np.load(old / "expected.npz")[name], atol=1e-6)


def test_store(old: Path) -> None:
    store = ModelStore(old / "store")
    assert store.numbers() == (1,)
    assert store.verify(1) < 1e-4  # its golden motion is answered as it was [N m]


def test_each_file_says_who_wrote_it(old: Path, tmp_path: Path) -> None:
    simulation = limo.Simulation.load(old / "given.yaml")
    recording = limo.read(old / "recording.parquet")
    own = written_by.installed()
    simulation.save(tmp_path / "sim.yaml")
    limo.read(old / "recording.parquet").save(tmp_path / "run.parquet")
    limo.Trajectory.load(old / "trajectory.parquet").save(tmp_path / "plan.parquet")
    verdict_in(old).save(tmp_path / "verdict.json")
    limo.LogMapping.load(old / "mapping.yaml").save(tmp_path / "mapping.yaml")
    assert f"limo: {own}" in (tmp_path / "sim.yaml").read_text().splitlines()
    assert f"limo: {own}" in (tmp_path / "mapping.yaml").read_text().splitlines()
    assert json.loads((tmp_path / "verdict.json").read_text())["limo"] == own
    for name, key in (("run", b"limo.recording"), ("plan", b"limo.trajectory")):
        metadata = pq.read_schema(tmp_path / f"{name}.parquet").metadata
        assert json.loads(metadata[key])["limo"] == own
    assert limo.Simulation.load(tmp_path / "sim.yaml") == simulation
    np.testing.assert_array_equal(limo.read(tmp_path / "run.parquet").torque, recording.torque)


def test_newer_file_that_cannot_be_read_names_the_version_that_can(old: Path) -> None:
    simulation, verdict = old / "given.yaml", old / "verdict.json"
    simulation.write_text("limo: 7.1.0\nwarmth: {of: air}\n" + simulation.read_text())
    verdict.write_text(json.dumps({"schema": 2, "limo": "7.1.0"}))
    table = pq.read_table(old / "trajectory.parquet").drop_columns(["velocity_1"])
    header = {b"limo.trajectory": json.dumps({"limo": "7.1.0"}).encode()}
    pq.write_table(table.replace_schema_metadata(header), old / "trajectory.parquet")
    advice = f"limo 7.1.0 wrote it and can read it, this is {written_by.installed()}"
    with pytest.raises(limo.LimoError, match=f"no 'warmth'.*{advice}"):
        limo.Simulation.load(simulation)
    with pytest.raises(limo.LimoError, match=f"schema.*{advice}"):
        verdict_in(old)
    with pytest.raises(limo.LimoError, match=f"lacks velocity_1.*{advice}"):
        limo.Trajectory.load(old / "trajectory.parquet")


def test_newer_file_that_can_be_read_is(old: Path) -> None:
    simulation = old / "given.yaml"
    same = limo.Simulation.load(simulation)
    simulation.write_text("limo: 7.1.0\n" + simulation.read_text())
    assert limo.Simulation.load(simulation) == same


@pytest.mark.parametrize("written", [None, 7, "", "banana", "0.1.0", written_by.installed()])
def test_older_or_odd_versions_get_no_advice(written: object) -> None:
    assert not written_by.advice_to_update(written)


def test_newer_model_names_its_version(old: Path) -> None:
    manifest = old / "network" / "manifest.json"
    content = json.loads(manifest.read_text())
    content["packages"]["limo"], content["schema"] = "7.1.0", 2
    manifest.write_text(json.dumps(content))
    with pytest.raises(limo.LimoError, match=r"schema is not 1; limo 7\.1\.0 wrote it"):
        limo.load_model(old / "network")
