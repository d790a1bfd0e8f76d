"""Benchmarks of others are computed from their files, and what is none of them is refused."""

import numpy as np
import pytest
from scipy.io import savemat

from estimators.studies.bench import BAXTER, EMPS, KR300, bench, industrial, trip
from limo_driver.errors import RecordingError

RATE, MASS, VISCOUS, COULOMB, GAIN = 1000.0, 95.0, 200.0, 20.0, 35.0


def slide(path, frequency):
    """Write a slide with friction as the files of the EMPS are."""
    t = np.arange(8000) / RATE
    w = 2 * np.pi * frequency
    position, velocity = 0.1 * np.sin(w * t), 0.1 * w * np.cos(w * t)
    force = -MASS * 0.1 * w**2 * np.sin(w * t) + VISCOUS * velocity + COULOMB * np.sign(velocity)
    force += np.random.default_rng(0).normal(0.0, 0.5, t.size)
    savemat(path, {"t": t, "qm": position, "vir": force / GAIN, "gtau": GAIN})


@pytest.mark.slow("identifies and learns a slide of 1 kHz twice")
def test_a_slide_is_identified_as_well_as_by_the_procedure_of_its_authors(tmp_path):
    for name, frequency in zip(EMPS, (0.7, 0.5), strict=True):
        slide(tmp_path / name, frequency)
    rows = {row.who: row for row in bench(tmp_path)}
    networks = {f"limo train --model {kind} --features drive" for kind in ("mlp7", "gru", "lru")}
    learned = {"limo train", "limo train --model joint-physics"}
    assert set(rows) == {"IDIM-LS", "limo identify"} | learned | networks
    assert max(rows[who].figure for who in learned | networks) < 2.0 * rows["IDIM-LS"].figure
    assert rows["IDIM-LS"].figure < 15.0
    assert rows["limo identify"].figure < 2.0 * rows["IDIM-LS"].figure


def test_a_folder_without_any_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="has the files of no benchmark, expected DATA_EMPS"):
        bench(tmp_path)


def test_a_file_of_another_kind_is_refused_by_name(tmp_path):
    for name in EMPS:
        savemat(tmp_path / name, {"other": np.zeros(3)})
    with pytest.raises(RecordingError, match=r"DATA_EMPS\.mat: is no file of the EMPS"):
        bench(tmp_path)


def test_angles_and_motor_torques_of_the_kr300_become_those_of_its_joints(tmp_path):
    wave = np.sin(np.linspace(0.0, 60.0, 600) * np.arange(1, 19)[:, None] / 9)
    values = {f"{name}_{part}": wave for name in "u" for part in ("train", "test")}
    values |= {f"y_{part}": wave[:6] for part in ("train", "test")}
    savemat(tmp_path / KR300[0], values)
    (learned,), (test,) = industrial(tmp_path / KR300[0])
    np.testing.assert_allclose(learned.position[:, 2], np.radians(wave[2]))
    np.testing.assert_allclose(test.torque[:, 2], 192.75 * wave[2])
    assert learned.rate == pytest.approx(10.0)


def test_a_recording_of_another_arm_than_baxter_is_refused_by_name(tmp_path):
    (tmp_path / BAXTER).write_text("<robot/>")
    for part in ("Training", "Test"):
        (tmp_path / part).mkdir()
        (tmp_path / part / "a_ang_vel_torq.csv").write_text("a b\n1 2\n3 4\n")
    with pytest.raises(RecordingError, match=r"a_ang_vel_torq\.csv: is no recording of Baxter"):
        bench(tmp_path)


def test_a_recording_of_baxter_is_read(tmp_path):
    t = np.arange(300) / 100
    values = np.sin(t[:, None] + np.arange(21))
    np.savetxt(tmp_path / "b.csv", values, header="columns", comments="")
    found = trip(tmp_path / "b.csv")
    np.testing.assert_allclose(found.torque, values[:, 14:])
    assert found.rate == pytest.approx(100.0)
