"""Where torch cannot be imported, everything works but the training of networks."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from estimators.hybrid.training.fit import find_device
from estimators.service.retraining.trainer import check_kind
from limo_driver.errors import MissingPackageError

ROOT = Path(__file__).parents[2]
BLOCKED = """
import sys
class NoTorch:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] == 'torch':
            raise ModuleNotFoundError("No module named 'torch'", name='torch')
sys.meta_path.insert(0, NoTorch())
"""
LIMO = """
import sys
from limo_driver.app.cli import main
for step in sys.argv[1:]:
    if step == "draw":
        assert "matplotlib" not in sys.modules
        continue
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
    "plan --robot iiwa14 --scaffolds 1 --seed 1 --out m.parquet",
    f"run --backend mujoco --trajectory m.parquet --sim {SIM} --record run.parquet --duration 8",
    "inspect run.parquet --robot iiwa14",
    "identify run.parquet --robot iiwa14 --out sim.yaml",
    "diagnose run.parquet --sim sim.yaml --out found",
    "predict run.parquet --sim sim.yaml --out torque.parquet",
    "train run.parquet --sim sim.yaml --model joint-physics --out model",
    "predict run.parquet --model model --out torque.parquet",
    "models add model --golden run.parquet --store models",
    "export sim.yaml --to mjcf --out exported",
    "draw",
    "plan --robot iiwa14 --scaffolds 1 --seed 1 --out m.parquet --picture plan.png",
    "evaluate run.parquet --model model --sim sim.yaml --out evaluation",
)
TRAIN = "train run.parquet --sim sim.yaml --model mlp7 --epochs 1 --folds 1 --out network"
IMPORTS = re.compile(r"^(?:import|from) (torch|matplotlib)\b", re.MULTILINE)


def run(code, *steps, folder=ROOT):
    return subprocess.run(
        [sys.executable, "-c", code, *steps],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.slow("plans, moves, learns and diagnoses")
def test_every_step_but_the_training_of_a_network_works(tmp_path):
    done = run(BLOCKED + LIMO, *STEPS, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "found" / "report.html").exists()
    refused = run(BLOCKED + LIMO, TRAIN, folder=tmp_path)
    assert refused.returncode == 2
    assert refused.stderr.splitlines()[-1].startswith("limo: training a network needs torch")
    assert run(LIMO, TRAIN, folder=tmp_path).returncode == 0
    predicted = run(BLOCKED + LIMO, "predict run.parquet --model network --out torque.parquet",
                    folder=tmp_path)  # fmt: skip
    assert predicted.returncode == 0, predicted.stderr


@pytest.mark.slow("starts a service")
def test_the_service_imports_neither_torch_nor_what_draws():
    code = (
        BLOCKED + "from estimators.service import server, arm_server\n"
        "from estimators.service.retraining import retraining as keeper\n"
        "import estimators.hybrid.fitted_network, estimators.joint_physics\n"
        "assert 'matplotlib' not in sys.modules\n"
    )
    done = run(code)
    assert done.returncode == 0, done.stderr


def test_only_training_imports_torch_and_only_pictures_what_draws():
    found: dict[str, set[str]] = {"torch": set(), "matplotlib": set()}
    for package in ("limo_driver", "backends", "estimators", "limopa"):
        for file in (ROOT / package).rglob("*.py"):
            for name in IMPORTS.findall(file.read_text("utf-8")):
                found[name].add(str(file.relative_to(ROOT)))
    assert found["torch"] == {
        "estimators/hybrid/training/passes.py",
        "estimators/neural/modules.py",
    }
    assert found["matplotlib"] == {
        "estimators/evaluation_page.py",
    }


def test_what_trains_a_network_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    for asked, argument in ((find_device, "auto"), (check_kind, "lstm-fcl")):
        with pytest.raises(
            MissingPackageError, match=r"network needs torch.* pip install 'torch>="
        ):
            asked(argument)
