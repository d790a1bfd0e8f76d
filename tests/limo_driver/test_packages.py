"""The four packages are there, under names of their own; what is missing or hidden is named."""

import ast
import re
import subprocess
import sys
from collections import defaultdict
from importlib import import_module
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from limo_driver.errors import MissingPackageError
from limo_driver.runtime.plugins import require_package

HERE = Path(__file__).resolve().parents[2]
PACKAGES = ["limo_driver", "backends", "estimators", "limopa"]
LIMO = "from limo_driver.cli import main; main()"


@pytest.mark.parametrize("name", PACKAGES)
def test_the_package_comes_from_this_project(name):
    """Another distribution named `backends` would win silently."""
    assert Path(import_module(name).__file__).resolve().parent.parent == HERE


def test_a_public_class_has_a_name_of_its_own():
    """Two of one name are told apart by their folder alone, which no error message shows."""
    places = defaultdict(list)
    for package in PACKAGES:
        for file in sorted((HERE / package).rglob("*.py")):
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places[node.name].append(str(file.relative_to(HERE)))
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


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
    files = [file for name in PACKAGES for file in (HERE / name).rglob("*.py")]
    text = "\n".join(file.read_text("utf-8") for file in files)
    assert set(re.findall(r"[(\[]sys\.executable, (\S+)", text)) == {'"-P",'}
