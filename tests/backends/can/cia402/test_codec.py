"""Scaling, states and frames of CiA 402; sums that the literature gives for buses."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from arms import COUNTS_PER_TURN, arm_config
from canopen.profiles.p402 import State402
from hypothesis import given, settings
from hypothesis import strategies as st

from backends.can.cia402.codec import (
    Codec,
    OperatingMode,
    State,
    bus_load,
    describe,
    state_of,
    towards_enabled,
)
from backends.can.port import BusLoad, Traffic, classic_bits, fd_bits
from limo_driver.errors import ConfigError

CONFIG = arm_config()
RATED = [100_000] * 7
CODEC = Codec(CONFIG.joints, RATED)


@given(st.integers(0, 0xFFFF))
def test_states_are_those_of_canopen(statusword):
    theirs = next(
        name
        for name, (mask, bits) in [*State402.SW_MASK.items(), ("UNKNOWN", (0, 0))]
        if statusword & mask == bits
    )
    ours = state_of(statusword).words.upper()
    names = {"NO STATE OF CIA 402": "UNKNOWN", "SWITCH-ON DISABLED": "SWITCH ON DISABLED"}
    assert names.get(ours, ours) == theirs


def test_way_up_and_no_reset_untold():
    words = [towards_enabled(s, 0, reset=False) for s in (State.SWITCH_ON_DISABLED, State.READY)]
    assert words == [0x06, 0x07]
    assert towards_enabled(State.SWITCHED_ON, 0, reset=False) == 0x0F
    assert towards_enabled(State.FAULT, 0, reset=False) == 0x00
    assert towards_enabled(State.QUICK_STOP, 0, reset=False) == 0x0F
    assert towards_enabled(State.FAULT_REACTION, 0, reset=True) == 0x02
    assert towards_enabled(State.FAULT, 0, reset=True) == 0x80
    assert towards_enabled(State.FAULT, 0x80, reset=True) == 0x00  # an edge, not a level


@settings(max_examples=50)
@given(st.lists(st.floats(-2.9, 2.9), min_size=7, max_size=7))
def test_positions_come_back_within_half_a_count(values):
    position = np.array(values)
    frames = CODEC.targets(position, [0x0F] * 7)
    counts = [struct.unpack("<Hih", data)[1] for data in frames]
    half = 0.5 * 2 * np.pi / COUNTS_PER_TURN
    assert np.abs(CODEC.positions(counts) - position).max() <= half * (1 + 1e-9)


def test_direction_and_offset():
    q = np.zeros(7)
    q[1] = 0.1 + 2 * np.pi / COUNTS_PER_TURN  # one count beyond its offset, turned round
    counts = [struct.unpack("<Hih", data)[1] for data in CODEC.targets(q, [0] * 7)]
    assert counts[1] == -1
    assert CODEC.velocities([0, -1, 0, 0, 0, 0, 0])[1] > 0


def test_torque_goes_in_steps_of_the_rating():
    codec = Codec(CONFIG.joints, [320_000] * 7)
    assert codec.torque_resolution == pytest.approx([0.32] * 7)
    sent = codec.torques(np.full(7, 1.0), OperatingMode.TORQUE)
    assert [struct.unpack("<hb", data) for data in sent[:2]] == [(3, 10), (-3, 10)]
    assert codec.measured_torques([3, -3, 0, 0, 0, 0, 0])[:2] == pytest.approx([0.96, 0.96])


@pytest.mark.parametrize("value", [1e12, -1e12])
def test_numbers_do_not_wrap(value):
    data = CODEC.targets(np.full(7, value), [0x0F] * 7)[0]
    assert abs(struct.unpack("<Hih", data)[1]) == 2**31 - 1
    torque = CODEC.torques(np.full(7, value), OperatingMode.TORQUE)[0]
    assert abs(struct.unpack("<hb", torque)[0]) == 32767


def test_bits_of_frames():
    # Davis et al. 2007: 135 bits for 8 bytes and 55 for none
    assert (classic_bits(8), classic_bits(0)) == (135, 55)
    slow, fast = fd_bits(8)
    assert slow < 40 < fast


def test_the_load_of_the_budget():
    cyclic = (
        Traffic("SYNC", 1, 0, 250.0),
        Traffic("set", 7, 8, 250.0),
        Traffic("got", 7, 8, 250.0),
    )
    load = BusLoad(cyclic, 1_000_000)
    assert load.share == pytest.approx(1945 * 250 / 1e6)
    assert "7 set x 135 us x 250 Hz = 23.6 %" in load.arithmetic()


def test_impossible_rate_is_refused_with_the_arithmetic():
    fast = replace(CONFIG, rate=1000.0)
    with pytest.raises(ConfigError, match=r"7 RPDO1 x 135 us x 1000 Hz = 94.5 %.*at most \d+ Hz"):
        bus_load(fast).require(fast.rate)
    fd = replace(fast, bus=replace(fast.bus, fd=True))
    bus_load(fd).require(fd.rate)


def test_highest_rate_fits_and_the_next_does_not():
    most = bus_load(CONFIG).most(CONFIG.rate)
    assert bus_load(replace(CONFIG, rate=most)).share == pytest.approx(0.95, abs=1e-9)


def test_torques_take_more_of_the_bus():
    fast = replace(CONFIG, rate=420.0)
    bus_load(fast).require(fast.rate)
    with pytest.raises(ConfigError, match="RPDO2"):
        bus_load(fast, torque=True).require(fast.rate)


def test_slow_bus_is_slow():
    slow = replace(CONFIG, bus=replace(CONFIG.bus, bitrate=125_000), rate=100.0)
    with pytest.raises(ConfigError, match="125000 bit/s"):
        bus_load(slow).require(slow.rate)
    hopeless = replace(CONFIG, bus=replace(CONFIG.bus, bitrate=10_000), watchdog=0.02)
    with pytest.raises(ConfigError, match="at most 0 Hz"):
        bus_load(hopeless).require(hopeless.rate)


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0, ""),
        (0x4310, "motor too hot (0x4310)"),
        (0x4399, "motor temperature (0x4399)"),
        (0x5530, "drive hardware (0x5530)"),
        (0xFF01, "error of the manufacturer (0xFF01)"),
    ],
)
def test_error_codes_in_words(code, text):
    assert describe(code) == text
