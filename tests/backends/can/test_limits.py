"""How full a bus may be, how long drives may be silent and how far they move, from both sides."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
from arms import NODES, START, arm_config, counts_at
from canopen_drives import CanopenArm
from lanes import sampled
from sync_bus import SyncBus

from backends.can import CanRobot
from backends.can.cia402.codec import MEASURED, STATUS, TEMPERATURE, OperatingMode, bus_load
from backends.can.cia402.drive import Drive
from backends.can.link import Link
from backends.can.port import BusLoad, Traffic, classic_bits, fd_bits
from limo_driver.errors import BackendError, ConfigError, HoldingError
from limo_driver.types import PositionCommand

ENABLED = 0x27
each_way = pytest.mark.parametrize("sign", [-1, 1])


class TestBusLoad:
    """95 % of a bus may be used, with worst stuffing."""

    @pytest.mark.parametrize(
        ("data", "bits"), [(0, 55), (1, 65), (2, 75), (3, 85), (7, 125), (8, 135)]
    )
    def test_of_a_classic_frame(self, data, bits):
        """As in Davis et al., 2007: (55 + 10 s) bits of an 11-bit identifier."""
        assert classic_bits(data) == bits
        assert BusLoad((), 500_000).duration(data) == pytest.approx(bits / 500_000, rel=1e-12)

    @pytest.mark.parametrize(
        ("data", "slow", "fast"), [(0, 34, 33), (1, 34, 43), (7, 34, 103), (8, 34, 113)]
    )
    def test_of_an_fd_frame(self, data, slow, fast):
        """Head 17 + 4 stuff bits + tail 13; 5 + 8 s bits, one stuffed of each four, checksum 27."""
        body = 5 + 8 * data
        assert fd_bits(data) == (17 + 4 + 13, body + (17 + body - 1) // 4 - 4 + 27)
        assert fd_bits(data)[0] == slow
        assert fd_bits(data)[1] == pytest.approx(fast, abs=2)
        load = BusLoad((), 1_000_000, 5_000_000)
        assert load.duration(data) == pytest.approx(slow / 1e6 + fd_bits(data)[1] / 5e6, rel=1e-12)

    def load(self, share, bitrate=135_000):
        """Return a load of frames of 135 bits, which take 1 ms each."""
        return BusLoad((Traffic("frames", 5, 8, 200.0 * share),), bitrate)

    @pytest.mark.parametrize(
        ("share", "fits"), [(0.5, 1), (0.949, 1), (0.951, 0), (1.0, 0), (1.5, 0)]
    )
    def test_fits_or_not(self, share, fits):
        load = self.load(share)
        assert load.share == pytest.approx(share, rel=1e-12)
        if fits:
            load.require(200.0 * share)
        else:
            with pytest.raises(ConfigError, match=r"95 % may be used; at most 190 Hz, or CAN FD"):
                load.require(200.0 * share)

    def test_says_the_highest_rate_that_fits(self):
        assert self.load(0.4).most(80.0) == pytest.approx(190.0)
        beats = Traffic("heartbeats", 1, 8, 450.0, cyclic=False)
        load = replace(self.load(0.4), traffic=(*self.load(0.4).traffic, beats))
        assert load.share == pytest.approx(0.85)
        assert load.most(80.0) == pytest.approx(100.0)
        full = replace(load, traffic=(load.traffic[0], replace(beats, rate=2000.0)))
        assert full.most(80.0) == 0.0
        assert "5 frames x 1000 us x 80 Hz = 40.0 %" in load.arithmetic()
        assert load.arithmetic().endswith("together 85.0 %")

    def test_of_an_arm_is_that_of_its_frames(self):
        config = arm_config(rate=250.0, watchdog=0.1, status_every=5)
        each = {"SYNC": (1, 55, 250), "RPDO1": (7, 135, 250), "TPDO1": (7, 135, 250),
                "TPDO2": (7, 125, 50), "TPDO3": (7, 75, 50), "heartbeats": (8, 65, 40)}  # fmt: skip
        load = bus_load(config)
        assert {item.what: item.count for item in load.traffic} == {
            what: count for what, (count, _, _) in each.items()
        }
        expected = sum(count * bits * rate for count, bits, rate in each.values()) / 1e6
        assert load.share == pytest.approx(expected, rel=1e-12)
        torque = bus_load(config, torque=True).share
        assert torque == pytest.approx(expected + 7 * 85 * 250 / 1e6, rel=1e-12)
        cold = bus_load(replace(config, temperature=None)).share
        assert cold == pytest.approx(expected - 7 * 75 * 50 / 1e6, rel=1e-12)


def heard(count=0, *, at=0.0, status=ENABLED, reach=math.inf):
    """Return a drive that has measured in a cycle that began at a time [s]."""
    drive = Drive(3, 13)
    drive.open_cycle(at, reach)
    drive.take_measured(MEASURED.pack(status, count, 0))
    return drive


class TestDrive:
    @pytest.mark.parametrize("hold_after", [1, 2, 20])
    def test_may_be_silent_for_less_than_so_many_cycles(self, hold_after):
        drive = heard()
        for silent in range(hold_after + 2):
            said = drive.complaint(hold_after, 1.0, 0.0)
            assert (said == "") == (silent < hold_after)
            assert drive.silent == silent
            if said:
                plural = "cycle" if silent == 1 else "cycles"
                assert said == f"is silent for {silent} {plural}"
            drive.open_cycle(0.01 * (silent + 1), math.inf)
            drive.close_cycle()

    @pytest.mark.parametrize("timeout", [0.1, 1.0])
    def test_may_be_without_a_heartbeat_for_so_long(self, timeout):
        drive = heard()
        assert drive.complaint(2, timeout, 99.0) == ""  # none ever came
        drive.take_heartbeat(b"\x05", 2.0)
        for late, fine in ((0.0, 1), (0.96, 1), (0.999, 1), (1.001, 0), (1.04, 0), (3.0, 0)):
            said = drive.complaint(2, timeout, 2.0 + late * timeout)
            assert (said == "") == fine, late
            if said:
                assert said == f"lost its heartbeat for {late * timeout:.3g} s"

    def test_may_be_without_a_heartbeat_for_just_as_long(self):
        drive = heard()
        drive.take_heartbeat(b"\x05", 2.0)
        assert drive.complaint(2, 0.125, 2.125) == ""

    def test_tells_what_is_known_of_it(self):
        drive = heard(at=1.0)
        assert drive.nmt == 0x05
        told = drive.told(0.1, 0.2, 0.3, 0.5)
        assert (told.node, told.enabled, told.status) == (13, True, "operation enabled")
        assert (told.position, told.velocity, told.torque) == (0.1, 0.2, 0.3)
        assert (told.mode, told.error, told.silent, told.stale) == ("", "", 0, False)
        assert math.isnan(told.temperature)
        drive.take_temperature(TEMPERATURE.pack(61))
        drive.take_status(STATUS.pack(0, 0, OperatingMode.TORQUE))
        told = drive.told(0.1, 0.2, 0.3, 0.5)
        assert (told.temperature, told.mode) == (30.5, "torque")
        assert not heard(status=0x08).told(0.1, 0.2, 0.3, 0.5).enabled

    def test_has_its_condition_in_words(self):
        drive = heard()
        assert drive.status == "operation enabled"
        drive.open_cycle(0.01, math.inf)
        drive.close_cycle()
        assert drive.status == "silent for 1 cycle, before: operation enabled"
        drive = heard()
        drive.take_emergency(b"\x10\x43" + bytes(6))
        assert drive.status.startswith("operation enabled: motor too hot")

    @each_way
    @pytest.mark.parametrize("before", [0, -70_000, 70_000])
    def test_moves_no_further_than_it_can(self, sign, before):
        for step, believed in ((960, 1), (1000, 1), (1001, 0), (1050, 0)):
            drive = heard(before)
            drive.open_cycle(0.01, 1000.0)
            drive.take_measured(MEASURED.pack(ENABLED, before + sign * step, 7))
            drive.close_cycle()
            assert (drive.heard, drive.implausible) == (bool(believed), 1 - believed)
            assert drive.count == (before + sign * step if believed else before)
            assert drive.silent == 1 - believed
            assert drive.per_mille == 7 * believed
        assert "its positions jump" in drive.complaint(1, 1.0, 0.0)

    @pytest.mark.parametrize(
        ("nmt", "said"),
        [
            (0x00, "restarted"), (0x04, "was stopped"), (0x05, ""), (0x7F, "left operation"),
            (0x85, ""), (0x84, "was stopped"),
        ],
    )  # fmt: skip
    def test_tells_by_its_heartbeat_that_it_left_operation(self, nmt, said):
        drive = heard()
        drive.take_heartbeat(bytes((nmt,)), 0.0)
        complaint = drive.complaint(2, 1.0, 0.0)
        assert complaint.startswith(said)
        assert bool(complaint) == bool(said)

    def test_has_to_be_enabled(self):
        assert heard().complaint(2, 1.0, 0.0) == ""
        drive = heard(status=0x08)
        assert drive.complaint(2, 1.0, 0.0) == "is in state 'fault'"
        drive.take_emergency(b"\x10\x43" + bytes(6))
        assert drive.complaint(2, 1.0, 0.0).startswith("is in state 'fault': motor too hot")

    def test_has_a_velocity_over_a_period_at_least(self):
        for seconds, speed in ((0.008, 100.0), (0.01, 100.0), (0.02, 50.0), (0.04, 25.0)):
            assert Drive(3, 13).velocity(0.01) == 0.0
            drive = heard(5)
            assert drive.velocity(0.01) == 0.0
            drive.open_cycle(seconds, math.inf)
            drive.take_measured(MEASURED.pack(ENABLED, 5, 0))
            drive.take_measured(MEASURED.pack(ENABLED, 6, 0))  # again, in the same cycle
            assert drive.velocity(0.01) == pytest.approx(speed)

    @pytest.mark.parametrize(
        ("take", "size"),
        [
            ("take_measured", MEASURED.size), ("take_status", STATUS.size),
            ("take_temperature", TEMPERATURE.size), ("take_emergency", 8), ("take_heartbeat", 1),
        ],
    )  # fmt: skip
    def test_is_not_believed_with_other_lengths(self, take, size):
        for length, broken in ((size - 1, 1), (size, 0), (size + 1, 1)):
            drive = Drive(3, 13)
            now = (0.0,) if take == "take_heartbeat" else ()
            getattr(drive, take)(bytes(length), *now)
            assert drive.broken == broken

    def test_that_is_late_was_not_silent(self):
        drive = heard()
        drive.open_cycle(0.01, math.inf)
        drive.close_cycle()
        assert (drive.silent, drive.prompt) == (1, False)
        drive.take_measured(MEASURED.pack(ENABLED, 1, 0))
        assert not drive.prompt
        drive.open_cycle(0.02, math.inf)
        assert drive.silent == 0
        drive.take_measured(MEASURED.pack(ENABLED, 1, 0))
        assert drive.prompt

    def test_begins_anew_where_it_was_asked(self):
        drive = heard()
        drive.open_cycle(0.01, 0.0)
        drive.take_measured(MEASURED.pack(ENABLED, 9, 0))
        drive.close_cycle()
        drive.refer(5.0)
        assert (drive.heard_at, drive.cycle_at, drive.before) == (5.0, 5.0, None)
        assert (drive.heard, drive.silent, drive.implausible) == (False, 0, 0)

    @pytest.mark.parametrize(
        ("answers", "doubled"),
        [((0, 2, 2, 2), (0, 0, 1, 2)), ((1, 2, 2), (0, 1, 2)), ((2, 2, 2), (0, 1, 2))],
    )
    def test_is_doubled_where_it_answers_twice_after_a_cycle_with_an_answer(self, answers, doubled):
        drive, found = heard(), []
        drive.answered, drive.doubled = True, 5
        drive.refer(5.0)  # asked anew
        assert drive.doubled == 0
        for count in answers:
            for _ in range(count):
                drive.take_measured(MEASURED.pack(ENABLED, 1, 0))
            drive.open_cycle(5.0, math.inf)
            found.append(drive.doubled)
        assert tuple(found) == doubled
        assert drive.complaint(1, 1.0, 0.0).startswith("answers twice, 2 cycles in a row")

    def test_of_which_nothing_is_known(self):
        drive = Drive(3, 13)
        assert (drive.count, drive.per_mille, drive.silent, drive.error) == (0, 0, 0, 0)
        assert (drive.broken, drive.implausible, drive.cycle_at) == (0, 0, 0.0)
        assert (drive.heard, drive.prompt, drive.heard_at) == (False, False, -math.inf)
        assert drive.controlword == 0
        drive.take_measured(MEASURED.pack(ENABLED, 10**9, 0))  # anywhere
        assert drive.heard


class Waiting(Link):
    """Hears from a bus on which frames come at given times [s], one each."""

    def __init__(self, period, times):
        super().__init__(self, period, SimpleNamespace(n=7))
        self.times, self.time, self.heard = list(times), 0.0, 0
        self.oversleeps = 0.0

    def now(self):
        return self.time

    def receive(self, until):
        if self.times and self.times[0] <= max(until, self.time):
            self.time = max(self.time, self.times.pop(0))
            return self.time
        self.time, self.oversleeps = max(self.time, until) + self.oversleeps, 0.0
        return None

    def _take(self, frame):  # noqa: ARG002  # a time
        self.heard += 1


Waiting.__abstractmethods__ = frozenset()


class TestWaitingForAnswers:
    """Until the cycle is due, half a period at least; one more for a patient arm, or a late one."""

    @pytest.mark.parametrize(
        ("until", "patient", "latest"),
        [(1.0, False, 1.0), (0.2, False, 0.5), (-3.0, False, 0.5), (1.0, True, 2.0),
         (0.2, True, 1.5), (0.6, False, 0.6)],
    )  # fmt: skip
    def test_lasts(self, until, patient, latest):
        for arrival, heard_it in ((0.97 * latest, 1), (latest, 1), (1.03 * latest, 0)):
            link = Waiting(1.0, [arrival])
            link._hear_answers(until, lambda link=link: link.heard == 1, patient=patient)
            assert link.heard == heard_it
            assert link.overslept == 0.0

    @pytest.mark.parametrize(
        ("late", "more"), [(0.24, False), (0.25, False), (0.26, True), (0.8, True)]
    )
    def test_lasts_a_period_longer_after_oversleeping_by_a_quarter(self, late, more):
        for after, heard_it in ((0.97, more), (1.03, False)):
            link = Waiting(1.0, [1.0 + late + after])
            link.oversleeps = late
            link._hear_answers(1.0, lambda link=link: link.heard == 1, patient=False)
            assert link.overslept == pytest.approx(late)
            assert bool(link.heard) == heard_it

    def test_ends_with_256_frames_of_a_babbling_node(self):
        link = Waiting(1.0, [0.0] * 1000)
        link.listen(0.0)
        assert link.heard == 256
        link = Waiting(1.0, [-1.0] * 3)
        link.listen(-0.5)
        assert link.heard == 3


@pytest.fixture
def bus():
    return SyncBus()


def opened(bus, config):
    return CanRobot(config, bus=bus, clock=bus.now)


class TestArm:
    @pytest.fixture
    def config(self):
        return arm_config(hold_after=2)

    @pytest.fixture
    def arm(self, bus, config):
        with CanopenArm(bus, NODES, counts_at(config, START)) as drives:
            yield drives

    @pytest.mark.usefixtures("arm")
    @pytest.mark.parametrize(("rated", "fine"), [(100.9, 1), (99.1, 1), (101.1, 0), (98.9, 0)])
    def test_is_rated_as_told_within_a_hundredth(self, bus, config, rated, fine):
        """The drives of this test are rated 100 N m."""
        joints = (*config.joints[:3], replace(config.joints[3], rated_torque=rated),
                  *config.joints[4:])  # fmt: skip
        told = replace(config, joints=joints)
        if fine:
            opened(bus, told).close()
        else:
            with pytest.raises(BackendError, match=r"joint 4 .*is rated 100000 mN m"):
                opened(bus, told)

    @each_way
    @pytest.mark.parametrize("j", [2, 5])
    def test_is_believed_to_move_at_1_2_times_its_velocity_limit(self, bus, config, arm, j, sign):
        """And by 0.01 rad more; over the time since it was heard, and the period that begins."""
        for factor, believed in ((0.99, True), (1.01, False)):
            with opened(bus, config) as robot:
                robot.receive()
                robot.receive()
                way = 1.2 * config.model.limits.velocity[j] * 2 * robot.spec.period + 0.01
                way *= factor * config.joints[j].counts_per_radian
                arm.drives[j].lag = sign * round(way)
                assert robot.receive().stale != believed, factor
                arm.drives[j].lag = 0

    @pytest.mark.usefixtures("arm")
    @sampled("watchdog", [0.4, 1.0], "ten seconds of cycles each")
    def test_is_told_four_times_a_watchdog_that_the_loop_runs(self, bus, config, watchdog):
        with opened(bus, replace(config, watchdog=watchdog)) as robot:
            robot.receive()
            bus.sent.clear()
            began = bus.now()
            while bus.now() < began + 10.0 - 1e-9:
                robot.receive()
            beats = [data for frame_id, data in bus.sent if frame_id == 0x77F]
        assert len(beats) == pytest.approx(10.0 * 4 / watchdog, abs=1.0)

    @pytest.mark.parametrize("hold_after", [1, 3])
    def test_holds_after_so_many_silent_cycles(self, bus, config, arm, hold_after):
        with opened(bus, replace(config, hold_after=hold_after)) as robot:
            state = robot.receive()
            robot.send(PositionCommand(position=state.position, valid_for=1.0))
            arm.drives[4].mute = True
            held = [robot.receive().holding for _ in range(hold_after + 2)]
            assert held == [False] * (hold_after - 1) + [True] * 3
            with pytest.raises(HoldingError, match=r"joint 5 \(node 15\) is silent"):
                robot.send(PositionCommand(position=state.position))
            arm.drives[4].mute = False
