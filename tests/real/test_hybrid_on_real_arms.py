"""The hybrid on a recording of a real arm whose motion it has not seen."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from estimators.evaluation import evaluate
from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import usual_settings
from estimators.rigid_body import Rows, identify
from limo_driver.model import RobotModel
from limo_driver.recordings.recording import Recording

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))


@pytest.mark.skipif(not (DATA / "ur10e").is_dir(), reason="no UR10e recordings; set LIMO_DATA")
@pytest.mark.slow("trains on real recordings, which few have")
def test_hybrid_carries_over_to_other_motion_of_a_ur10e() -> None:
    trained = Recording.load(DATA / "ur10e" / "unloaded_14harm.parquet")
    robot = RobotModel.load(DATA / "ur10e" / "ur10e.urdf")
    simulation = identify(robot, [trained], rows=Rows(8.0)).simulation
    model = HybridModel(simulation, usual_settings("drive")).fit([trained])
    found = evaluate(model, Recording.load(DATA / "ur10e" / "unloaded_15harm.parquet"))
    assert (found.hybrid.rmse < 1.02 * found.rigid_body.rmse).all()  # 2 %: a seed's luck
    assert found.mean_mse_ratio > 1.1
    assert np.median(found.mse_ratio) > 1.5
