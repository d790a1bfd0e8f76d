"""Arms come to rest whichever way a program ends."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lanes import sampled
from robot_commands import START, smooth_move

from limo_driver.errors import RecordingError
from limo_driver.recordings.files.recorder import Recorder, read_header
from limo_driver.robot import interrupts
from limo_driver.robot import robot as robot_module
from limo_driver.robot.playback import Playback
from limo_driver.robot.registry import open_robot
from limo_driver.trajectory import Trajectory
from limo_driver.types import PositionCommand

pytestmark = pytest.mark.waits

MOVING = """
import os, signal, sys
import numpy as np
import limo_driver as limo
from backends.virtual import VirtualRobot

# whoever runs the tests may ignore some of them, as a shell does for what it runs behind
signal.signal(signal.SIGINT, signal.default_int_handler)
for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
    signal.signal(number, signal.SIG_DFL)

class Told(VirtualRobot):
    "An arm that says how it was left."
    path = []

    def _cycle_once(self):
        state = super()._cycle_once()
        self.path.append(state.position[0])
        return state

    def _close(self):
        path = np.array(self.path)
        speed, change = np.diff(path) / 1e-3, np.diff(path, n=2) / 1e-6
        most = np.abs(speed).max() / self.spec.limits.velocity[0]
        steepest = np.abs(change).max() / self.spec.limits.acceleration[0]
        print(f"left at {abs(speed[-1]):.9f} after {most:.6f} and {steepest:.6f}", flush=True)

def move(robot, then):
    start = robot.receive().position
    for k in range(10**9):
        away = min(k, 600) * 1.2e-3
        robot.send(limo.PositionCommand(position=start + away * np.eye(7)[0]))
        robot.receive()
        if k == 400:
            print("moving", flush=True)
            then()
"""


def left(program, number=None, *, status):
    """Run a program until its arm moves, send it a signal, and return how its arm was left."""
    script = MOVING + textwrap.dedent(program)
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        try:
            assert child.stdout.readline() == "moving\n", child.stderr.read()
            if number is not None:
                child.send_signal(number)
            out, err = child.communicate(timeout=120)
        finally:
            child.kill()  # nothing of one that has ended
        assert child.returncode == status, err
    words = out.split()
    assert words[:2] == ["left", "at"]
    speed, fastest, steepest = float(words[2]), float(words[4]), float(words[6])
    assert fastest > 0.5  # it really moved
    assert steepest < 1.0 + 1e-4
    return speed


@pytest.mark.slow("each starts a Python")
class TestPrograms:
    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
    @pytest.mark.parametrize("inside", [True, False])
    def test_that_are_ended_leave_the_arm_at_rest(self, number, inside):
        arm = "Told(robot='iiwa14')"
        opened = f"with {arm} as robot: " if inside else f"robot = {arm}; "
        program = f"{opened}robot.keep_time(); move(robot, lambda: None)"
        assert left(program, number, status=128 + number) == 0.0

    def test_that_are_interrupted_leave_the_arm_at_rest(self):
        program = "with Told(robot='iiwa14') as robot: robot.keep_time(); move(robot, lambda: None)"
        assert left(program, signal.SIGINT, status=-signal.SIGINT) == 0.0

    @pytest.mark.parametrize("again", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
    def test_that_are_signalled_again_while_the_arm_brakes_leave_it_at_rest(self, again):
        program = f"""
        class Impatient(Told):
            def _cycle_once(self):
                if not self._open and len(self.path) % 20 == 0:
                    os.kill(os.getpid(), {int(again)})
                return super()._cycle_once()
        with Impatient(robot='iiwa14') as robot:
            move(robot, lambda: os.kill(os.getpid(), signal.SIGTERM))
        """
        status = -again if again == signal.SIGINT else 128 + again
        assert left(program, status=status) == 0.0

    @pytest.mark.parametrize("what", ["raise ValueError", "sys.exit(1)", "print(file=broken)"])
    def test_that_fail_leave_the_arm_at_rest(self, what):
        program = f"""
        broken = open("/dev/full", "w", buffering=1)
        def fail(): {what}
        with Told(robot='iiwa14') as robot: move(robot, fail)
        """
        assert left(program, status=1) == 0.0

    def test_that_never_close_their_robot_leave_the_arm_at_rest(self):
        program = """
        def fail(): raise ValueError
        move(Told(robot='iiwa14'), fail)
        """
        assert left(program, status=1) == 0.0


class TestSignals:
    @pytest.fixture(autouse=True)
    def usual_handlers(self):
        """Begin as a program does, whoever ran before in this process."""
        before = {number: signal.signal(number, signal.SIG_DFL) for number in interrupts.ENDING}
        before[signal.SIGINT] = signal.signal(signal.SIGINT, signal.default_int_handler)
        yield
        for number, handler in before.items():
            signal.signal(number, handler)

    @pytest.mark.parametrize("number", [signal.SIGINT, *interrupts.ENDING])
    def test_in_the_middle_of_a_cycle_wait_for_its_end(self, number, monkeypatch):
        with open_robot("virtual", robot="iiwa14") as robot:
            start = robot.receive().position
            for k in range(20):
                robot.send(PositionCommand(position=start + 1e-5 * k * k, valid_for=1.0))
                robot.receive()
            last = PositionCommand(position=start + 1e-5 * 20**2, valid_for=1.0)
            sent = robot.send(last).position
            observe = robot._contract.observe

            def interrupted(state):
                signal.raise_signal(number)
                return observe(state)

            monkeypatch.setattr(robot._contract, "observe", interrupted)
            with pytest.raises((SystemExit, KeyboardInterrupt)):
                robot.receive()
            monkeypatch.undo()
            assert np.array_equal(robot.setpoint, sent)

    @sampled("number", [signal.SIGINT, signal.SIGTERM], "opens and closes an arm for each line")
    def test_at_any_line_of_closing_leave_the_arm_at_rest(self, number):
        files, line, left = {interrupts.__file__, robot_module.__file__}, 0, False
        while line == 0 or left:
            line, passed, left = line + 1, itertools.count(1), False
            robot = open_robot("virtual", robot="iiwa14")

            def at_lines(frame, event, _, robot=robot, passed=passed, line=line):
                nonlocal left
                if frame.f_code.co_filename not in files or robot.standing:
                    return None
                if event == "line" and not left and next(passed) == line:
                    left = True
                    signal.raise_signal(number)
                return at_lines

            try:
                with robot:
                    start = robot.receive().position
                    for k in range(4):
                        robot.send(PositionCommand(position=start + 2e-6 * k * k))
                        robot.receive()
                    sys.settrace(at_lines)
            except (KeyboardInterrupt, SystemExit):
                assert left
            finally:
                sys.settrace(None)
            assert robot.standing
        assert line > 30

    def test_act_as_before_once_the_robot_is_closed(self):
        before = [signal.getsignal(number) for number in interrupts.ENDING]
        with open_robot("virtual", robot="iiwa14") as robot:
            state = robot.receive()
            assert [signal.getsignal(number) for number in interrupts.ENDING] == before
            robot.send(PositionCommand(position=state.position))
            for number in interrupts.ENDING:
                with pytest.raises(SystemExit) as left:
                    signal.raise_signal(number)
                assert left.value.code == 128 + number
        assert [signal.getsignal(number) for number in interrupts.ENDING] == before

    def test_that_the_program_takes_itself_are_left_alone(self):
        taken = []
        before = signal.signal(signal.SIGTERM, lambda *_: taken.append(1))
        try:
            with open_robot("virtual", robot="iiwa14") as robot:
                robot.send(PositionCommand(position=robot.receive().position))
                signal.raise_signal(signal.SIGTERM)
        finally:
            signal.signal(signal.SIGTERM, before)
        assert taken == [1]


@pytest.fixture
def motion():
    path = smooth_move(0.3, 600)
    velocity = np.gradient(path, 1e-3, axis=0)
    acceleration = np.gradient(velocity, 1e-3, axis=0)
    return Trajectory(np.arange(600) * 1e-3, path, velocity, acceleration)


class TestRuns:
    """What is raised in a run leaves it once the arm is at rest, and not before."""

    @pytest.fixture
    def robot(self):
        with open_robot("virtual", robot="iiwa14", initial_position=START) as opened:
            yield opened

    def play(self, robot, motion, tmp_path, **options):
        progress = options.pop("progress", lambda *_: None)
        return Playback(motion, tmp_path / "run.parquet", **options).run(robot, progress)

    @pytest.mark.parametrize("where", ["progress", "publish"])
    def test_callbacks_that_raise(self, robot, motion, tmp_path, where):
        cycles = []

        def fail(*_):
            cycles.append(1)
            if len(cycles) > (300 if where == "publish" else 0):
                raise ValueError(where)

        with pytest.raises(ValueError, match=where):
            self.play(robot, motion, tmp_path, **{where: fail})
        assert robot.standing
        assert read_header(pq.read_table(tmp_path / "run.parquet"))["stopped"] == where
        assert not robot.receive().velocity.any()

    def test_a_full_disk_is_said_at_the_end(self, robot, motion, tmp_path, monkeypatch):
        def full(_):
            raise OSError(28, "No space left on device")

        def choke(recorder):
            recorder._sync = lambda: full(recorder)
            return recorder

        made = Playback._recorder
        monkeypatch.setattr(Playback, "_recorder", lambda *args: choke(made(*args)))
        with pytest.raises(RecordingError, match="No space left"):
            self.play(robot, motion, tmp_path)
        assert robot.receive().position == pytest.approx(motion.position[-1], abs=1e-9)

    def test_a_recorder_that_is_broken_drops_what_it_cannot_write(self, tmp_path, robot):
        recorder, state = Recorder(tmp_path / "run.parquet", 7, {}), robot.receive()

        def broken():
            raise pa.ArrowInvalid("no such column")

        recorder._flush = broken
        recorder._thread.join(timeout=60)
        for _ in range(10):
            recorder.append(state)
        assert not recorder._rows
        with pytest.raises(RecordingError, match="no such column"):
            recorder.close()
