"""What tests of several parts share."""

from pathlib import Path

import pytest

from limo_driver.physics import Simulation


@pytest.fixture(scope="session")
def hysteretic():
    """The simulation of the examples: friction with memory, noise, quantised encoders."""
    return Simulation.load(Path(__file__).parents[1] / "examples" / "iiwa14_hysteretic.yaml")
