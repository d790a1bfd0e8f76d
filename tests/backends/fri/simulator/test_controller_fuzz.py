"""Datagrams of every kind: the controller says what they were, goes on, and moves nothing."""

import pytest
from controller_fuzzing import fuzz_controller

from backends.fri.simulator.report import MOST_COMPLAINTS
from backends.fri.simulator.session import POSE

pytestmark = pytest.mark.waits


@pytest.mark.slow("sends thousands of datagrams")
def test_the_controller_outlives_what_it_is_sent():
    sent, report, packet = fuzz_controller(8000, seed=1)
    packets = report["packets"]
    counted = ("malformed", "answered", "repeated", "unknown")
    assert sum(packets[name] for name in counted) >= 0.9 * sent  # the kernel may drop some
    assert packets["malformed"] > 0.5 * sent
    assert packets["answered"] > 100
    assert len(report["complaints"]) <= MOST_COMPLAINTS + 1
    assert report["states"][-1]["state"] == "IDLE"
    # what was not refused was within one cycle's limits
    assert packet.data.measured_position == pytest.approx(POSE, abs=0.05)
