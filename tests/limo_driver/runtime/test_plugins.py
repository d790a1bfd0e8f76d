"""Plug-ins are looked for when a name is asked for; what cannot be used is said to who asks."""

from __future__ import annotations

import subprocess
import sys

import pytest

from estimators.model_folder import load_model
from estimators.residual_model import estimator_called, to_train
from limo_driver.errors import ConfigError, ModelStoreError, PlugInError
from limo_driver.physics import CATALOGUE, Simulation, catalogue
from limo_driver.runtime import plugins
from limo_driver.runtime.plugins import EFFECTS, ESTIMATORS, ROBOTS, find

SPRING = """
from dataclasses import dataclass
from typing import ClassVar
from limo_driver.physics import TorqueEffect, parameter

@dataclass(frozen=True, kw_only=True)
class Spring(TorqueEffect):
    name: ClassVar[str] = "second_spring"
    stiffness: float = parameter("N m/rad", "stiffness", lower=0.0, upper=10.0)

    def advance(self, state, motion):
        return self.stiffness * motion.position, state

class Half(TorqueEffect):
    name = "half"

Number = 3
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Put distributions where Python finds them, for as long as a test."""

    def forget():
        plugins._registered.cache_clear()
        catalogue._usable.cache_clear()

    def put(distribution, group, *entries):
        about = tmp_path / f"{distribution}-1.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1")
        (about / "entry_points.txt").write_text("\n".join([f"[{group}]", *entries]))
        forget()

    (tmp_path / "springs_of_a_test.py").write_text(SPRING)
    monkeypatch.syspath_prepend(tmp_path)
    yield put
    sys.modules.pop("springs_of_a_test", None)
    forget()
    monkeypatch.undo()


@pytest.fixture
def load(tmp_path):
    """Read a simulation with one effect."""

    def read(effect):
        path = tmp_path / "sim.yaml"
        path.write_text(f"robot: iiwa14\neffects:\n- {effect}\n")
        return Simulation.load(path)

    return read


def test_an_effect_of_another_distribution_is_read_and_written(install, load, tmp_path):
    install("springs", EFFECTS, "second_spring = springs_of_a_test:Spring")
    simulation = load("{effect: second_spring, joint: 2, stiffness: 4}")
    simulation.save(tmp_path / "again.yaml")
    assert Simulation.load(tmp_path / "again.yaml") == simulation
    with pytest.raises(ConfigError, match=r"line 3: effects: second_spring: stiffness is 11 N m"):
        load("{effect: second_spring, joint: 2, stiffness: 11}")
    with pytest.raises(ConfigError, match=r"is 'third', expected one of .*, second_spring, "):
        load("{effect: third, joint: 2}")
    assert catalogue.every_effect()[-1] is type(simulation.effects[0])


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ("broken = nowhere:Spring", "ModuleNotFoundError: No module named 'nowhere'"),
        ("broken = springs_of_a_test:Gone", "AttributeError: "),
        ("broken = springs_of_a_test:Number", "is no subclass of one of BodyEffect, ArmEffect, "),
        ("broken = springs_of_a_test:Half", "Half does not define advance"),
        ("broken = springs_of_a_test:Spring", "Spring calls itself 'second_spring', not 'broken'"),
    ],
)
def test_an_effect_that_cannot_be_used_is_an_error_for_who_names_it(install, load, entry, reason):
    install("springs", EFFECTS, entry, "second_spring = springs_of_a_test:Spring")
    assert load("{effect: armature, joint: 2, inertia: 0.1}").effects
    with pytest.raises(ConfigError) as refused:
        load("{effect: broken, joint: 2}")
    plug_in = f"entry point `{entry}` in limo.effects of distribution springs"
    assert f"line 3: effects: broken: {plug_in} cannot be used: {reason}" in str(refused.value)
    names = [effect.name for effect in catalogue.every_effect()]
    assert names == [*CATALOGUE, "second_spring"]
    assert [error.plug_in for error in catalogue.unusable()] == ["broken"]


def test_no_effect_takes_the_name_of_one_of_limos_own(install, load):
    install("springs", EFFECTS, "armature = springs_of_a_test:Spring")
    with pytest.raises(ConfigError, match=r"distribution springs .* is a name of limo's own"):
        load("{effect: armature, joint: 2, inertia: 0.1}")
    assert load("{effect: torque_offset, joint: 2, offset: 0.1}").effects
    assert catalogue.every_effect() == tuple(CATALOGUE.values())


def test_two_distributions_cannot_use_one_name(install, load):
    install("springs", EFFECTS, "second_spring = springs_of_a_test:Spring")
    install("coils", EFFECTS, "second_spring = springs_of_a_test:Spring")
    with pytest.raises(ConfigError, match=r"(springs|coils) registers that name, too"):
        load("{effect: second_spring, joint: 2, stiffness: 4}")


def test_no_robot_takes_the_name_of_one_of_limos_own(install):
    install("springs", ROBOTS, "virtual = springs_of_a_test:Spring")
    with pytest.raises(PlugInError, match="distribution springs"):
        find(ROBOTS, "virtual")
    assert find(ROBOTS, "mujoco").__name__ == "MujocoRobot"


def test_an_estimator_that_cannot_be_used_is_an_error_for_who_names_it(install):
    install(
        "springs", ESTIMATORS,
        "broken = nowhere:Model", "spring = springs_of_a_test:Spring", "mlp7 = nowhere:Model",
    )  # fmt: skip
    assert estimator_called("joint-physics").__name__ == "JointPhysics"
    with pytest.raises(PlugInError, match=r"springs cannot be used: ModuleNotFoundError: "):
        estimator_called("broken")
    with pytest.raises(PlugInError, match=r"is no subclass of .*ResidualModel"):
        to_train("spring")
    with pytest.raises(PlugInError, match="'mlp7' is a name of limo's own"):
        to_train("mlp7", own=("mlp7",))
    with pytest.raises(ConfigError, match=r"'rigid-body' keeps no model folder"):
        estimator_called("rigid-body")
    with pytest.raises(ConfigError, match=r"trained by the name of its network"):
        to_train("hybrid")


def test_a_model_of_an_estimator_that_is_gone_names_it(tmp_path):
    (tmp_path / "manifest.json").write_text('{"schema": 1, "estimator": "gone"}')
    with pytest.raises(ModelStoreError, match=r"is 'gone', expected one of hybrid, joint-physics"):
        load_model(tmp_path)


@pytest.mark.slow("starts a process that imports everything")
def test_nothing_is_looked_for_before_a_name_is_asked_for():
    code = (
        "import limo_driver.physics, limo_driver.app.cli, estimators.model_folder\n"
        "from limo_driver.runtime import plugins\n"
        "assert not plugins._registered.cache_info().currsize"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
