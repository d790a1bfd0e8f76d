"""Datagrams of every kind: the driver neither crashes nor commands out of contract."""

import pytest
from fri_fuzzing import fuzz

from backends.fri.codec.messages import CommandMode


@pytest.mark.parametrize(
    "mode",
    [
        CommandMode.POSITION,
        pytest.param(CommandMode.TORQUE, marks=pytest.mark.slow("5000 cycles of fuzz once more")),
    ],
)
def test_driver_keeps_its_contract_whatever_comes(mode):
    happened = fuzz(5000, seed=1, mode=mode)
    assert happened["commands"] > 800
    assert happened["link"]["implausible"] > 100  # poses that jump while the arm is commanded
    assert happened["link"]["malformed"] > 500
    assert happened["link"]["restarts"] > 5
