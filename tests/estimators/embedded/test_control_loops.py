"""The examples of control loops compile against the interfaces that they are written for."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from lanes import sampled
from wandering import calm

from estimators.embedded.export import export_c
from limo_driver.physics import Simulation

EXAMPLES = Path(__file__).parents[3] / "examples" / "embedded"
STUBS = Path(__file__).with_name("stubs")
SOURCES = ("ros2_control/limo_effort_controller", "libfranka/contact_stop", "fri/overlay_client")


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
@sampled("source", SOURCES, "each runs a compiler")
def test_the_example_compiles_with_the_exported_header(source: str, tmp_path: Path) -> None:
    arm = Simulation("iiwa14")
    export_c(arm, tmp_path, 1000.0, free=[calm(arm, 1000.0, 12.0)])
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    command = ["g++", *flags, f"-I{STUBS}", f"-I{tmp_path}", str(EXAMPLES / f"{source}.cpp")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_example_is_compiled() -> None:
    found = {str(p.relative_to(EXAMPLES).with_suffix("")) for p in EXAMPLES.rglob("*.cpp")}
    assert found == set(SOURCES)
