"""Packages that are missing or hidden: one line says what to do."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from limo_driver.errors import MissingPackageError
from limo_driver.runtime.packages import require_package

ROOT = Path(__file__).parents[3]
LIMO = "from limo_driver.cli import main; main()"


@pytest.mark.parametrize(
    ("module", "distribution"),
    [
        ("cryptography", "cryptography"),
        ("onnx", "onnx"),
        ("pxr", "usd-core"),
        ("ray", "ray"),
        ("rerun", "rerun-sdk"),
        ("river", "river"),
        ("torch", "torch"),
    ],
)
def test_what_is_missing_is_named_as_pip_takes_it(monkeypatch, module, distribution):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingPackageError) as caught:
        require_package(module, "this")
    requirement = Requirement(caught.value.requirement)
    assert (requirement.name, bool(requirement.specifier)) == (distribution, True)
    assert str(caught.value) == (
        f"this needs {module}, which is not installed: pip install '{caught.value.requirement}'"
    )


def test_what_is_there_is_not_imported(monkeypatch):
    monkeypatch.delitem(sys.modules, "antigravity", raising=False)
    require_package("antigravity", "this")
    assert "antigravity" not in sys.modules


@pytest.mark.parametrize("package", ["backends", "estimators", "limopa"])
def test_a_folder_of_the_user_that_hides_a_package_is_named(tmp_path, package):
    hiding = tmp_path / package / "__init__.py"
    hiding.parent.mkdir()
    hiding.touch()

    def run(code, *options):
        return subprocess.run(
            [sys.executable, *options, "-c", code, "--version"],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip

    refused = run(LIMO)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert f"`import {package}` finds {hiding}, which hides limo's" in refused.stderr
    library = "import limo_driver as limo\ntry: limo.diagnose\nexcept limo.LimoError as e: print(e)"
    assert f"finds {hiding}" in run(library).stdout
    assert run(LIMO, "-P").returncode == 0  # as the script `limo` is run


def test_what_limo_starts_ignores_the_packages_of_a_users_folder():
    packages = ("limo_driver", "backends", "estimators", "limopa")
    files = [file for name in packages for file in (ROOT / name).rglob("*.py")]
    text = "\n".join(file.read_text("utf-8") for file in files)
    assert set(re.findall(r"[(\[]sys\.executable, (\S+)", text)) == {'"-P",'}
