"""docs/physics.md describes the catalogue as it is."""

import re
from pathlib import Path

import numpy as np
import pytest

from limo_driver.physics import CATALOGUE
from limo_driver.physics.effects.changing_friction import VARIANTS
from limo_driver.physics.effects.hysteresis import LAWS

TEXT = (Path(__file__).parents[3] / "docs" / "physics.md").read_text()


def section(name: str) -> str:
    heading = f"### `{name}`"
    assert heading in TEXT
    return TEXT.split(heading)[1].split("\n##")[0]


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_every_effect_and_parameter_is_described(name):
    text = section(name)
    for parameter in CATALOGUE[name].parameters():
        unit = parameter.unit.replace("^2", "²").replace("^3", "³")
        assert f"| `{parameter.name}` | {unit} |" in text
    for word in ("*Signature:*", "*Excited by:*", "*Confused with:*", "*Source:*"):
        assert word in text.replace("\n", " ")


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_bounds_and_defaults_are_the_ones_that_are_checked(name):
    for parameter in CATALOGUE[name].parameters():
        row = re.search(rf"\| `{parameter.name}` \| [^|]* \| ([^|]*) \| ([^|]*) \|", section(name))
        if parameter.unit == "text" or parameter.name == "ratio":  # words, and 1 or −1
            continue
        bounds = re.match(r"(\S+) to ([^\s,]+)", row[1].replace("\N{MINUS SIGN}", "-"))
        assert [float(value) for value in bounds.groups()] == [parameter.lower, parameter.upper]
        assert np.isfinite([parameter.lower, parameter.upper]).all()


def test_nothing_else_is_in_the_catalogue():
    headings = set(re.findall(r"^### `(\w+)`", TEXT, flags=re.MULTILINE))
    assert headings == {*CATALOGUE, "link_inertia"}  # which is an entry of inertials


def test_every_law_and_variant_is_described():
    assert all(f"| `{law}` |" in section("presliding_hysteresis") for law in LAWS)
    friction = section("load_dependent_friction")
    assert all(f"`{variant}`" in friction for variant in VARIANTS)
