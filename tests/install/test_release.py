"""What a release is made of tells one version, one list of packages, and targets that there are."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
VERSION, BASE = PROJECT["version"], PROJECT["dependencies"]
ON_CONDA = {  # of a distribution that is called otherwise on conda-forge
    "matplotlib": "matplotlib-base",
    "mujoco": "mujoco-python",
    "pin": "pinocchio",
    "torch": "pytorch",
}
BESIDE = {"python", "msgpack-python"}  # the second is an extra of python-can
RECIPE = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text("utf-8"))


def test_every_file_tells_the_same_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    newest = re.search(r"^## (\d+\.\d+\.\d+)", changes, re.MULTILINE)
    assert newest is not None
    told = {citation["version"], RECIPE["context"]["version"], newest.group(1)}
    assert told == {VERSION}


def test_the_recipe_has_what_is_declared():
    wanted = {
        (ON_CONDA.get(item.name, item.name), item.specifier) for item in map(Requirement, BASE)
    }
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
