"""The four packages are ours: another distribution named `backends` would win silently."""

from importlib import import_module
from pathlib import Path

import pytest


@pytest.mark.parametrize("name", ["limo_driver", "backends", "estimators", "limopa"])
def test_the_package_comes_from_this_project(name):
    here = Path(__file__).resolve().parents[2]
    assert Path(import_module(name).__file__).resolve().parent.parent == here
