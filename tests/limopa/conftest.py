from __future__ import annotations

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import pytest

from limo_driver.model import RobotModel
from limopa import Plan, PlanRequest, plan

SCAFFOLDS = 6


@pytest.fixture(scope="session")
def iiwa() -> RobotModel:
    return RobotModel.load("iiwa14")


@pytest.fixture(scope="session")
def panda() -> RobotModel:
    try:
        found = [f for f in files("example-robot-data") or () if f.name == "panda_collision.urdf"]
    except PackageNotFoundError:
        pytest.skip("example-robot-data, which has the Panda's URDF, is not installed")
    return RobotModel.load(Path(str(found[0].locate())))


@pytest.fixture(scope="session")
def short_plan(iiwa: RobotModel) -> Plan:
    return plan(iiwa, PlanRequest(scaffolds=SCAFFOLDS), seed=3)
