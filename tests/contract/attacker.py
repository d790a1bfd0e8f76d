"""Random use and abuse of a robot, cycle by cycle, under the eye of a judge at its wire."""

from collections import Counter
from contextlib import suppress

import numpy as np
from wire_rules import IMPEDANCE, POSITION, TORQUE, Judge

from limo_driver.errors import LimoError
from limo_driver.types import ImpedanceCommand, PositionCommand, TorqueCommand

ACTIONS = (
    "follow", "leap", "edge", "push", "float", "spring", "switch_stiffness", "mix", "hold",
    "blink", "wait", "lose", "blind", "jump", "clock", "interrupt",
)  # fmt: skip


class Attacker:
    """Uses one robot at random.

    Args:
        rig: The robot with its wire and its disturbances.
        seed: Of all that is drawn.
    """

    def __init__(self, rig, seed=0):
        self.rig, self.robot = rig, rig.robot
        self.random = np.random.default_rng(seed)
        # One judges by what was measured, the other by where the arm really is.
        self.judge, self.witness = (
            Judge(rig.robot.spec, rig.quanta, gains=rig.gains, true=true) for true in (False, True)
        )
        self.limits, self.n = rig.robot.spec.limits, rig.robot.spec.n
        self.goal = np.zeros(self.n)
        self.state = self.robot.receive()
        self.truth = rig.truth(self.state)
        if told := [item for item in rig.told() if item is not None]:
            self.judge.judge(told[-1], self.state)
            self.witness.judge(told[-1], self.truth)
        self.sent = None
        self.failing = False
        self.fired = Counter()  # faults of each kind
        self.holds = {}  # of each fault that had to be held: how often, longest and longest stated

    @property
    def cycles(self):
        """Cycles that were judged."""
        return self.judge.cycles

    @property
    def worst(self):
        """The largest step of each limit, by what was measured and where the arm is."""
        true = {f"true {name}": share for name, share in self.witness.worst.items()}
        return self.judge.worst | true

    def act(self, action, seed):
        """Do something for some cycles."""
        self.random = np.random.default_rng(seed)
        if self.state.holding and self.random.random() < 0.8:
            with suppress(LimoError):
                self.robot.resume()
        getattr(self, action)()

    # what a cycle is ----------------------------------------------------------------------------

    def cycle(self, *commands):
        """Send commands, some or none, and receive; then judge what the drives had."""
        self.sent = None
        for command in commands:
            with suppress(LimoError):
                self.sent = self.robot.send(command)
        self.receive()

    def receive(self):
        before, true, sent = self.state, self.truth, self.sent
        with suppress(LimoError):
            self.state = self.robot.receive()
        self.truth = self.rig.truth(self.state)
        told = self.rig.told()
        for item in told:
            if item is None:
                self.forget()
                continue
            self.judge.judge(item, before, true.position)
            try:
                self.witness.judge(item, true)
            except AssertionError as error:
                raise AssertionError(f"where the arm is, {error}") from None
        if sent is not None and len(told) == 1 and told[0] is not None and not self.rig.delayed:
            self.compare(sent, told[0])
        assert np.isfinite(self.state.position).all()

    def forget(self):
        """Begin anew: the robot was under its own command."""
        self.judge.forget()
        self.witness.forget()

    def compare(self, sent, item):
        """Check that what `send` returned is what the drives had."""
        if {PositionCommand: POSITION, ImpedanceCommand: IMPEDANCE, TorqueCommand: TORQUE}[
            type(sent)
        ] != item.mode:  # Damiao motors have one mode for all
            return
        quanta = self.rig.quanta
        # What was heard, and what is believed, are two things while something fails, and while
        # drives are silent: the gravity that is taken off here is that of where they are now.
        unknown = self.failing or self.state.stale
        guessed = {"torque"} if unknown and np.any(item.carried) else set()
        for name in {"position", "torque", "stiffness", "damping"} - guessed:
            if (given := getattr(sent, name, None)) is not None:
                off = np.abs(given - getattr(item, name))
                assert (off <= 1e-9 + getattr(quanta, name)).all(), f"{name} is not what was said"

    # faults -------------------------------------------------------------------------------------

    def fail(self, fault, seed):
        """Let a stream meet a fault, and go on with it; check that it is held in time."""
        self.random = np.random.default_rng(seed)
        stream, rigid, commanded = self.speed_up()
        self.fired[fault] += 1
        self.failing = True
        cycles, within = self.rig.begin(fault, self.random, rigid)
        began, took = self.rig.now(), None
        hasty = self.random.random() < 0.3  # a program that resumes whenever the arm holds
        for _ in range(cycles + 2):
            if hasty and took is not None:
                with suppress(LimoError):
                    self.robot.resume()
            self.cycle(stream(20.0))
            if self.state.holding and took is None:
                took = self.rig.now() - began
        self.rig.end()
        if commanded and within is not None:
            self.check_hold(fault, took, within)
        for _ in range(8):
            self.cycle(stream(20.0))
        self.failing = False

    def speed_up(self):
        """Return what makes the next command, whether it is rigid, and whether one is in force."""
        self.recover()
        for _ in range(2):
            stream, rigid = self.stream()
            self.cycle(stream(0.0))
            for _ in range(int(self.random.integers(10, 30))):
                self.cycle(stream(1.0))
            if self.sent is not None and not self.state.holding:
                return stream, rigid, True
            self.rest()
            self.rig.settle()
            self.receive()
            self.recover()
        return stream, rigid, False

    def check_hold(self, fault, took, within):
        """Check that a hold came in time; it is noticed with the next measurement."""
        assert took is not None, f"{fault}: no hold, {within:.3g} s are stated"
        assert took <= within + 2 * self.robot.spec.period + 1e-9, (
            f"{fault}: held after {took:.3g} s, {within:.3g} s are stated"
        )
        count, longest, stated = self.holds.get(fault, (0, 0.0, 0.0))
        self.holds[fault] = count + 1, max(longest, took), max(stated, within)

    def recover(self):
        """Take commands again, whatever went wrong before."""
        if not self.state.holding:
            return
        try:
            self.robot.resume()
        except LimoError:
            self.rest()
            with suppress(LimoError):
                self.rig.mend()
            self.forget()
            for judge in (self.judge, self.witness):
                judge.sure = False  # what a spring has there already is not a step
        self.cycle()

    def rest(self):
        """Let the arm come to rest."""
        for _ in range(200):
            if self.robot.standing:
                break
            self.cycle()

    def stream(self):
        """Return what makes the next command of a stream of some vigour, and if it is rigid."""
        kind = self.random.choice(self.rig.kinds)
        away = self.random.choice([-1.0, 1.0], self.n)
        if kind == POSITION:
            place = self.state.position
            return lambda vigour: self.position(place + np.sign(vigour) * away), True
        push = 0.02 * away * self.limits.torque
        if kind == TORQUE:
            return lambda vigour: self.torque(vigour * push), False
        place, gains = self.state.position, self.gains()
        return lambda vigour: self.impedance(place, *gains, 0.2 * vigour * push), False

    # commands -----------------------------------------------------------------------------------

    def position(self, values):
        return PositionCommand(position=np.asarray(values, dtype=float))

    def torque(self, values):
        return TorqueCommand(torque=np.asarray(values, dtype=float))

    def impedance(self, values, stiffness, damping, torque):
        zero = np.zeros(self.n)
        return ImpedanceCommand(
            position=np.asarray(values, dtype=float), stiffness=zero + stiffness,
            damping=zero + damping, torque=zero + torque,
        )  # fmt: skip

    def any_command(self):
        kind, near = self.random.choice(self.rig.kinds), self.state.position
        near = near + self.random.uniform(-0.015, 0.015, self.n)
        if kind == POSITION:
            return self.position(near)
        torque = self.random.uniform(-1.5, 1.5, self.n) * self.limits.torque
        if kind == TORQUE:
            return self.torque(torque * self.random.choice([0.0, 0.02, 1.0]))
        return self.impedance(near, *self.gains(), torque * self.random.choice([0.0, 0.02]))

    def gains(self):
        stiffness = 10 ** self.random.uniform(-1, 3.5) * self.limits.torque / 320.0
        stiffness *= self.random.integers(0, 2, self.n)
        return np.minimum(stiffness, 500.0), np.minimum(0.05 * stiffness, 5.0)

    # actions ------------------------------------------------------------------------------------

    def follow(self):
        """Follow a smooth motion."""
        start = self.robot.setpoint
        speed = self.random.uniform(-0.5, 0.5, self.n) * self.limits.velocity
        for k in range(20):
            ramp = min(k / 60, 1.0) * k * self.robot.spec.period
            self.cycle(self.position(start + speed * ramp))

    def leap(self):
        """Ask for positions far away, one after the other, once a stream runs."""
        self.cycle(self.position(self.state.position))
        low, high = self.limits.position_min - 1.0, self.limits.position_max + 1.0
        for _ in range(3):
            goal = self.random.uniform(low, high)
            for _ in range(self.random.integers(1, 12)):
                self.cycle(self.position(goal))

    def edge(self):
        """Go to an end of the range as fast as can be, and to and fro there."""
        self.cycle(self.position(self.state.position))
        end = self.limits.position_max if self.random.random() < 0.5 else self.limits.position_min
        for _ in range(20):
            self.cycle(self.position(end + self.random.uniform(-0.01, 0.01, self.n)))

    def push(self):
        """Push as hard as can be, one joint or all."""
        wanted = self.random.uniform(-2.0, 2.0, self.n) * self.limits.torque
        wanted *= self.random.random(self.n) < self.random.random()
        for _ in range(self.random.integers(1, 12)):
            self.cycle(self.torque(wanted))

    def float(self):
        """Give way, with some damping."""
        for _ in range(15):
            damping = 0.02 * self.limits.torque / self.limits.velocity
            self.cycle(self.torque(-damping * self.state.velocity))

    def spring(self):
        """Follow as a spring, from where the arm is."""
        goal, gains = self.state.position, self.gains()
        for _ in range(15):
            self.cycle(self.impedance(goal, *gains, 0.0))

    def switch_stiffness(self):
        """Switch a stiffness on and off, away from its set-point."""
        goal, gains = self.state.position, self.gains()
        for k in range(15):
            away = goal + 0.002 * k
            on = k % 2
            self.cycle(self.impedance(away, gains[0] * on, gains[1] * on, 0.0))

    def mix(self):
        """Change the mind several times a cycle, holding and resuming in between."""
        for _ in range(6):
            self.sent = None
            for _ in range(self.random.integers(1, 5)):
                with suppress(LimoError):
                    choice = self.random.random()
                    if choice < 0.15:
                        self.robot.hold("attacked")
                        self.sent = None
                    elif choice < 0.4:
                        self.robot.resume()
                    else:
                        self.sent = self.robot.send(self.any_command())
            self.receive()

    def hold(self):
        self.robot.hold("attacked")
        for _ in range(self.random.integers(1, 20)):
            self.cycle()

    def blink(self):
        """Hold and go on in the same cycle, without a command or with one."""
        self.robot.hold("attacked")
        with suppress(LimoError):
            self.robot.resume()
        self.cycle(*[self.any_command()] * self.random.integers(0, 2))
        for _ in range(self.random.integers(0, 10)):
            self.cycle()

    def wait(self):
        """Say nothing until the last command has expired, or not quite."""
        for _ in range(self.random.integers(1, int(0.12 / self.robot.spec.period))):
            self.cycle()

    def lose(self):
        """Lose measurements, commanding on."""
        self.rig.lose(int(self.random.integers(1, 20)))
        for _ in range(20):
            self.cycle(*([self.any_command()] if self.random.random() < 0.5 else []))

    def blind(self):
        """Measure what is no number."""
        name = self.random.choice(["position", "velocity", "torque"])
        bad = np.where(self.random.random(self.n) < 0.3, np.nan, 0.0)
        self.rig.spoil(int(self.random.integers(1, 15)), **{str(name): bad})
        self.commands(15)

    def jump(self):
        """Measure a pose that the arm cannot have, once or twice."""
        away = self.random.uniform(-0.5, 0.5) * (self.random.random(self.n) < 0.3)
        self.rig.spoil(int(self.random.integers(1, 3)), position=away)
        self.commands(6)

    def clock(self):
        """Let the robot's clock jump, back or forth."""
        self.rig.turn_clock(self.random.choice([-3600.0, -0.5, 0.05, 3600.0]))
        self.commands(5)

    def interrupt(self):
        """Take the command back for a moment, where a robot can."""
        self.sent = None
        self.rig.interrupt()
        self.receive()
        self.commands(3)

    def commands(self, cycles):
        for _ in range(cycles):
            self.cycle(*([self.any_command()] if self.random.random() < 0.7 else []))
