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
    return RobotModel.load(example("panda_collision.urdf"))


@pytest.fixture(scope="session")
def meshed_panda() -> RobotModel:
    return RobotModel.load(example("panda.urdf"))


@pytest.fixture(scope="session")
def ur5() -> RobotModel:
    return RobotModel.load(example("ur5_robot.urdf"))


@pytest.fixture(scope="session")
def tiago() -> RobotModel:
    """The arm of a TIAGo on its torso, which slides."""
    return RobotModel.load(f"{example('tiago.urdf')}#torso_lift_joint,arm_*")


def example(name: str) -> str:
    """Return the path of a description of example-robot-data."""
    try:
        found = [f for f in files("example-robot-data") or () if f.name == name]
    except PackageNotFoundError:
        pytest.skip("example-robot-data, which has descriptions of arms, is not installed")
    return str(Path(str(found[0].locate())).resolve())


@pytest.fixture(scope="session")
def short_plan(iiwa: RobotModel) -> Plan:
    return plan(iiwa, PlanRequest(scaffolds=SCAFFOLDS), seed=3)
