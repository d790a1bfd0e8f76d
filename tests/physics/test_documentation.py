"""docs/physics.md describes the catalogue as it is."""

from pathlib import Path

import pytest

from limo_driver.physics import CATALOGUE

TEXT = (Path(__file__).parents[2] / "docs" / "physics.md").read_text()


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_every_effect_and_parameter_is_described(name):
    heading = f"### `{name}`"
    assert heading in TEXT
    section = TEXT.split(heading)[1].split("\n##")[0]
    for parameter in CATALOGUE[name].parameters():
        assert (
            f"| `{parameter.name}` | {parameter.unit.replace('^2', '²').replace('^3', '³')}"
            in section
        )
    for word in ("*Gives it away:*", "*Excited by:*", "*Confused with:*", "*Source:*"):
        assert word in section.replace("\n", " ")
