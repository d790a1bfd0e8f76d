"""MuJoCo that is broken or old ends a command with one line that says what to install."""

import subprocess
import sys

import pytest

BROKEN = 'raise ImportError("its core bindings are missing\\nRepair it")'
SAID = {
    "without its library": (BROKEN, "cannot be imported (its core bindings are missing)"),
    "what pip left of it": (None, "cannot be imported (module 'mujoco' has no attribute"),
    "old": ('__version__ = "3.11.0"', "MuJoCo 3.11.0 is installed, expected 3.12 or newer"),
}


@pytest.mark.parametrize("how", SAID)
def test_one_line_says_what_to_install(how, tmp_path):
    source, said = SAID[how]
    (folder := tmp_path / "mujoco").mkdir()
    if source is not None:
        (folder / "__init__.py").write_text(source, "utf-8")
    robot = tmp_path / "arm.xml"
    robot.write_text("<mujoco/>", "utf-8")
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
    if source is None:  # a folder without __init__ gives way to any package further along
        code += "import types; sys.modules['mujoco'] = types.ModuleType('mujoco')\n"
    code += "from limo_driver.app.cli import main; sys.argv[0] = 'limo'; main()"
    command = [sys.executable, "-c", code, "plan", "--robot", str(robot), "--out", "x.parquet"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("limo: MuJoCo ")
    assert said in done.stderr
    assert "pip install" in done.stderr
