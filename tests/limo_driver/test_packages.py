import ast
from collections import defaultdict
from importlib import import_module
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parents[2]
PACKAGES = ["limo_driver", "backends", "estimators", "limopa"]


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
