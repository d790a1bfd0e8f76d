"""What the contract suites share."""

from pathlib import Path

import pytest

from limo_driver.physics import Simulation

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="session")
def hysteretic():
    """The simulation of the examples: friction with memory, noise, quantised encoders."""
    return Simulation.load(EXAMPLES / "iiwa14_hysteretic.yaml")
