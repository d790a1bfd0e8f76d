"""What commands compile: each function once, for one signature, whatever hands it its arrays."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import limo_driver

ROOT = Path(limo_driver.__file__).parents[1]
SIM = ROOT / "examples" / "iiwa14_hysteretic.yaml"
SESSION = """
import json, sys
from limo_driver.app.cli import main
for words in json.loads(sys.stdin.read()):
    sys.argv = ["limo", *words]
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
from limo_driver.runtime.compiled import signatures
print(json.dumps(signatures()))
"""


@pytest.mark.slow("compiles all that seven commands compile")
def test_commands_compile_each_function_for_one_signature(tmp_path):
    run = ("run", "--trajectory", "t.parquet", "--duration", "6", "--sim", str(SIM), "--json")
    train = ("train", "r.parquet", "--sim", "sim.yaml", "--folds", "1", "--features", "drive")
    commands = [
        ("plan", "--scaffolds", "1", "--seed", "3", "--out", "t.parquet"),
        (*run, "--backend", "mujoco", "--record", "r.parquet"),
        (*run, "--backend", "virtual", "--record", "v.parquet", "--impedance", "300"),
        ("identify", "r.parquet", "--robot", "iiwa14", "--out", "sim.yaml"),
        (*train, "--epochs", "1", "--out", "drive"),
        ("predict", "v.parquet", "--model", "drive", "--out", "p.parquet"),
        ("predict", "v.parquet", "--sim", str(SIM), "--out", "q.parquet"),
    ]
    done = subprocess.run(
        [sys.executable, "-c", SESSION],
        input=json.dumps(commands),
        check=True,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["backends.mujoco_sim.engine._advance"] == 1
    assert {name: count for name, count in found.items() if count > 1} == {}
