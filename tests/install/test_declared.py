"""Imports are declared, what is declared is imported, and what is released fits both.

`python tests/install/test_declared.py` writes requirements-light.txt anew from pyproject.toml.
"""

from __future__ import annotations

import re
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PACKAGES = ("limo_driver", "backends", "estimators", "limopa")
DISTRIBUTION = {  # of an import that is called otherwise than what is installed
    "can": "python-can",
    "google": "protobuf",
    "pinocchio": "pin",
    "pxr": "usd-core",
    "rerun": "rerun-sdk",
    "yaml": "pyyaml",
    "zenoh": "eclipse-zenoh",
}
OF_THE_CHECKOUT = {"robots", "docs", "bench", "dev"}  # extras that no package imports
IMPORT = re.compile(
    r"""^\s*from\ (\w+)[\w.]*\ import\b | ^\s*import\ (\w+)[\w.]*(?:$|\ as|\s*\#)"""
    r"""| (?:import_module|find_spec)\(["'](\w+)""",
    re.MULTILINE | re.VERBOSE,
)  # parsing all files takes seconds

BASE = [Requirement(text) for text in PROJECT["dependencies"]]
EXTRAS = {
    extra: [Requirement(text) for text in texts]
    for extra, texts in PROJECT["optional-dependencies"].items()
}
EVERY = [*BASE, *(item for items in EXTRAS.values() for item in items)]
ON_CONDA = {  # of a distribution that is called otherwise on conda-forge
    "matplotlib": "matplotlib-base",
    "mujoco": "mujoco-python",
    "pin": "pinocchio",
    "torch": "pytorch",
}
BESIDE = {"python", "msgpack-python"}  # the second is an extra of python-can
RECIPE = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text("utf-8"))
LIGHT = ROOT / "requirements-light.txt"
TRAINING = "torch"  # all that a light installation lacks


def light() -> str:
    """Return the requirements of everything but training."""
    lines = (text for text in PROJECT["dependencies"] if Requirement(text).name != TRAINING)
    return "\n".join(("# limo without training; by tests/install/test_declared.py", *lines, ""))


def imports_of(source: str) -> set[str]:
    """Return the top-level modules that a source imports, also by a function."""
    return {next(filter(None, found.groups())) for found in IMPORT.finditer(source)}


@cache
def third_party() -> dict[str, list[str]]:
    """Return the distributions that the packages import, and the files that do."""
    found: dict[str, list[str]] = {}
    for file in (file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        for name in imports_of(file.read_text(encoding="utf-8")):
            if name not in sys.stdlib_module_names and name not in PACKAGES:
                distribution = canonicalize_name(DISTRIBUTION.get(name, name))
                found.setdefault(distribution, []).append(str(file.relative_to(ROOT)))
    return found


def names(requirements) -> set[str]:
    return {canonicalize_name(item.name) for item in requirements}


def test_every_import_is_declared():
    imported = third_party()
    assert "numpy" in imported
    missing = {name: files for name, files in imported.items() if name not in names(EVERY)}
    assert not missing, f"pyproject.toml does not declare what is imported: {missing}"


def test_every_dependency_is_imported():
    used = [
        item for extra, items in EXTRAS.items() if extra not in OF_THE_CHECKOUT for item in items
    ]
    idle = names(BASE + used) - set(third_party())
    assert not idle, f"pyproject.toml declares what no package imports: {sorted(idle)}"


@pytest.mark.parametrize(
    "source", ["import lz4.frame", "from lz4 import frame", "importlib.import_module('lz4.frame')"]
)
def test_an_import_is_seen(source):
    assert imports_of(source) == {"lz4"}


def test_constraints_fit_what_is_declared():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = (Requirement(line) for line in lines if not line.startswith("#"))
    pinned = {canonicalize_name(item.name): next(iter(item.specifier)).version for item in pins}
    wrong = [
        f"{item} is {pinned.get(canonicalize_name(item.name), 'not pinned')}"
        for item in EVERY
        if not item.specifier.contains(pinned.get(canonicalize_name(item.name), "0"))
    ]
    assert not wrong, f"constraints.txt does not fit pyproject.toml: {wrong}"


def test_a_light_installation_lacks_what_trains_and_nothing_else():
    assert LIGHT.read_text(encoding="utf-8") == light()
    assert names(BASE) - names(map(Requirement, light().splitlines()[1:])) == {TRAINING}


def test_every_file_tells_the_same_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    newest = re.search(r"^## (\d+\.\d+\.\d+)", changes, re.MULTILINE)
    assert newest is not None
    told = {citation["version"], RECIPE["context"]["version"], newest.group(1)}
    assert told == {PROJECT["version"]}


def test_the_recipe_has_what_is_declared():
    wanted = {(ON_CONDA.get(item.name, item.name), item.specifier) for item in BASE}
    listed = [Requirement(line.replace(" ", "")) for line in RECIPE["requirements"]["run"]]
    found = {(item.name, item.specifier) for item in listed if item.name not in BESIDE}
    assert found == wanted


@pytest.mark.parametrize("file", sorted((ROOT / ".github" / "workflows").glob("*.yml")), ids=str)
def test_workflows_call_targets_that_there_are(file):
    jobs = yaml.safe_load(file.read_text("utf-8"))["jobs"].values()
    ran = [step["run"] for job in jobs for step in job["steps"] if "run" in step]
    makefile = (ROOT / "Makefile").read_text("utf-8")
    assert ran
    for command in ran:
        make, *targets = command.split()
        assert make == "make"
        for target in targets:
            assert re.search(rf"^{re.escape(target)}:", makefile, re.MULTILINE), command


if __name__ == "__main__":
    LIGHT.write_text(light(), encoding="utf-8")
