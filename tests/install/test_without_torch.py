"""Where torch cannot be imported, everything works but the training and use of networks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BLOCKED = """
import sys
class NoTorch:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] == 'torch':
            raise ModuleNotFoundError("No module named 'torch'", name='torch')
sys.meta_path.insert(0, NoTorch())
"""
LIMO = BLOCKED + "from limo_driver.cli import main; main()"
SIM = ROOT / "examples" / "iiwa14_hysteretic.yaml"
STEPS = (
    "plan --robot iiwa14 --scaffolds 1 --seed 1 --out m.parquet --picture plan.png",
    f"run --backend mujoco --trajectory m.parquet --sim {SIM} --record run.parquet",
    "inspect run.parquet --robot iiwa14",
    "identify run.parquet --robot iiwa14 --out sim.yaml",
    "predict run.parquet --sim sim.yaml --out torque.parquet",
    "train run.parquet --sim sim.yaml --model joint-physics --out model",
    "evaluate run.parquet --model model --sim sim.yaml --out evaluation",
    "predict run.parquet --model model --out torque.parquet",
    "models add model --golden run.parquet --store models",
    "export sim.yaml --to mjcf --out exported",
    "demo --out demo",  # which diagnoses
)


def limo(words, folder):
    return subprocess.run(
        [sys.executable, "-c", LIMO, *words.split()], cwd=folder, capture_output=True, text=True,
        check=False,
    )  # fmt: skip


@pytest.mark.slow("plans, moves, learns and diagnoses")
def test_every_step_but_networks_works(tmp_path):
    for words in STEPS:
        done = limo(words, tmp_path)
        assert done.returncode == 0, f"limo {words}:\n{done.stderr}"
    assert (tmp_path / "demo" / "report.html").exists()


@pytest.mark.slow("starts a service")
def test_the_service_of_joint_physics_imports_no_torch():
    code = (
        BLOCKED + "from estimators.service import server, arm_server\n"
        "from estimators.service.retraining import keeper\n"
        "import estimators.joint_physics\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
