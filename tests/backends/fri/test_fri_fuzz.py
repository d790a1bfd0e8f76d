"""Datagrams of every kind: the driver neither crashes nor commands out of contract."""

from fri_fuzzing import fuzz
from lanes import sampled

from backends.fri.codec.messages import CommandMode


@sampled(
    ("cycles", "mode"),
    [(1000, CommandMode.POSITION), (5000, CommandMode.TORQUE)],
    "5000 cycles of fuzz",
)
def test_driver_keeps_its_contract_whatever_comes(cycles, mode):
    happened = fuzz(cycles, seed=1, mode=mode)
    assert happened["commands"] > 0.16 * cycles
    assert happened["link"]["implausible"] > 0.02 * cycles  # poses that jump while it is commanded
    assert happened["link"]["malformed"] > 0.1 * cycles
    assert happened["link"]["restarts"] > 0.001 * cycles
