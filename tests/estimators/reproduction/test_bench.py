"""Benchmarks of others are computed from their files, and what is none of them is refused."""

import numpy as np
import pytest
from scipy.io import savemat

from estimators.studies.bench import EMPS, bench
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
    assert set(rows) == {"IDIM-LS", "limo identify", "limo train --model joint-physics"}
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
