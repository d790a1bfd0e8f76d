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
LIMO = f"""{BLOCKED}
from limo_driver.app.cli import main
for step in sys.argv[1:]:
    print("limo", step, file=sys.stderr)
    sys.argv = ["limo", *step.split()]
    try:
        main()
    except SystemExit as ended:
        if ended.code:
            raise
"""
SIM = ROOT / "examples" / "iiwa14_hysteretic.yaml"
STEPS = (
    "plan --robot iiwa14 --scaffolds 1 --seed 1 --out m.parquet --picture plan.png",
    f"run --backend mujoco --trajectory m.parquet --sim {SIM} --record run.parquet --duration 8",
    "inspect run.parquet --robot iiwa14",
    "identify run.parquet --robot iiwa14 --out sim.yaml",
    "diagnose run.parquet --sim sim.yaml --out found",
    "predict run.parquet --sim sim.yaml --out torque.parquet",
    "train run.parquet --sim sim.yaml --model joint-physics --out model",
    "evaluate run.parquet --model model --sim sim.yaml --out evaluation",
    "predict run.parquet --model model --out torque.parquet",
    "models add model --golden run.parquet --store models",
    "export sim.yaml --to mjcf --out exported",
)


@pytest.mark.slow("plans, moves, learns and diagnoses")
def test_every_step_but_networks_works(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", LIMO, *STEPS],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "found" / "report.html").exists()


@pytest.mark.slow("starts a service")
def test_the_service_of_joint_physics_imports_no_torch():
    code = (
        BLOCKED + "from estimators.service import server, arm_server\n"
        "from estimators.service.retraining import keeper\n"
        "import estimators.joint_physics\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
