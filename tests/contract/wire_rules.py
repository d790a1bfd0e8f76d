"""The safety contract as a judge at the wire sees it: numbers of one cycle after the other.

Nothing here comes from the code that limits commands; limits, wire and measurements are given.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

POSITION, IMPEDANCE, TORQUE = "position", "impedance", "torque"
ROUNDING = 1e-5  # relative
# A false pose that an arm can have got to may be believed: it is so many cycles' way off, at the
# velocity limit, and a distance [rad].
BELIEVED, DISTANCE = 5, 0.05


@dataclass(frozen=True)
class Applied:
    """What the drives had in one cycle, (n,) each; what their mode does not use is zero."""

    mode: str
    position: np.ndarray
    torque: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    velocity: np.ndarray | float = 0.0  # of the set-point, where it is damped
    carried: np.ndarray | float = 0.0  # gravity, where it is on the wire with the torque [N m]
    steps: int = 1  # cycles since the last that arrived, where others were lost on their way
    stopped: np.ndarray | bool = False  # joints whose drive was told to stop, not to follow


class Place(NamedTuple):
    """A set-point, and how many cycles it is from the one before."""

    position: np.ndarray
    steps: int = 1


@dataclass(frozen=True)
class Quanta:
    """Steps in which the wire counts."""

    position: float = 1e-12  # [rad]
    torque: float = 1e-9  # [N m]
    stiffness: float = 0.0  # [N m/rad]
    damping: float = 0.0  # [N m s/rad]
    velocity: float = 0.0  # [rad/s]


class Judge:
    """Compares what is applied in a cycle with what was before.

    Args:
        spec: The robot and its limits.
        quanta: Of its wire.
        gains: Stiffness and damping by which drives keep positions, where they do all by one law.
            Then a wire does not say when a spring begins anew where the arm is, or whether gravity
            counts with a torque: what is right one way or the other is right, cycle after cycle.
        true: Whether states are where the arm is, whatever was measured. Set-points that begin
            anew are as far from it as a false pose may be that an arm can have got to; what they
            accelerate from there is judged by what was measured.

    Of commands that are lost on their way, nobody knows whether they count: the next one may be as
    many steps on as there were cycles, or one from the last that arrived.
    """

    def __init__(self, spec, quanta=None, *, gains=None, true=False):
        self.gains, self.true = gains, true
        self.limits, self.period, self.jerk = spec.limits, spec.period, spec.jerk
        self.quanta = quanta or Quanta()
        self.step = spec.limits.torque_rate * spec.period  # [N m]
        self.fade = np.zeros(spec.n)  # what is left of the last torque
        self.sure = True
        self.forget()
        self.cycles = 0
        self.worst = {}  # of each limit, how much of it was used at most
        self.used = {}  # in the cycle that is judged

    def forget(self):
        """Begin anew: the robot was under its own command."""
        self.before, self.paths = None, [[]]
        self.fade = self.fade * 0.0

    def judge(self, now, state, true=None):
        """Check what is applied after a state was measured.

        Set-points that begin anew may do so where the arm is, or else where it truly is (n,).
        """
        self.cycles += 1
        for name in ("position", "torque", "stiffness", "damping"):
            assert np.isfinite(getattr(now, name)).all(), f"{name} is not finite"
        # Nobody measured what torque a spring had; what other terms add does not depend on that.
        if self._sprung(now) and state.stale and not self._equal_gains(now):
            self.sure = False
        possible, problems, tried = {}, [], []
        starts = [state.position] if true is None else [state.position, true]
        for steps in dict.fromkeys((1, now.steps)):
            for anew in self._begins_anew(now):
                for path, start in product(self.paths, starts[: 1 + anew]):
                    self.used = {}
                    tried.append(self.used)
                    try:
                        fade = self._torques(now, state, anew, steps)
                        longer = self._positions(now, state, path, anew, start, steps)
                    except AssertionError as error:
                        problems.append(str(error))
                        continue
                    possible[b"".join(p.position.tobytes() for p in longer), steps] = longer, fade
        for name, share in min(tried, key=lambda used: max(used.values(), default=0.0)).items():
            self.worst[name] = max(self.worst.get(name, 0.0), share)
        assert possible, "; or else ".join(dict.fromkeys(problems))
        self.paths = [path for path, _ in possible.values()]
        self.sure = self.sure or now.mode != POSITION
        self.fade, self.before = next(reversed(possible.values()))[1], now

    def _within(self, name, values, allowed, but=False):
        """Check values against what is allowed, apart from some joints."""
        share = float(np.where(but, 0.0, values / allowed).max())
        self.used[name] = max(self.used.get(name, 0.0), share)
        assert share <= 1.0, f"{name} {share:.4g}"

    def _sprung(self, now):
        return IMPEDANCE in {now.mode, self.before and self.before.mode}

    def _equal_gains(self, now):
        before = self.before
        return before is not None and all(
            (np.abs(getattr(now, name) - getattr(before, name)) <= getattr(self.quanta, name)).all()
            for name in ("stiffness", "damping")
        )

    def _begins_anew(self, now):
        """Say whether set-points begin where the arm is; both, where that cannot be told."""
        before = self.before
        if before is None or before.mode != IMPEDANCE:
            return (before is not None and before.mode == TORQUE,)
        if now.mode == POSITION:
            return (True,)
        if self.gains is None or (self._keeps(before) and self._keeps(now)):
            return (False,)
        return False, True

    def _keeps(self, item):
        """Say whether drives that do all by one law keep a position."""
        near = zip(self.gains, (item.stiffness, item.damping), strict=True)
        steps = self.quanta.stiffness, self.quanta.damping
        return all(
            (np.abs(kept - told) <= step).all()
            for (kept, told), step in zip(near, steps, strict=True)
        )

    def _positions(self, now, state, path, anew, start, steps):
        """Return the path of set-points with this one; of those before, the last three count."""
        limits, quantum = self.limits, self.quanta.position
        if now.mode == TORQUE:
            return []
        here = Place(now.position, steps)
        if self.before is None:
            return [here]
        if not path or anew:
            # It gave way: set-points begin where it is, as fast as it moves at most.
            if state.stale:
                return [here]
            if self.true:
                away = np.abs(now.position - start)
                self._within("start", away, BELIEVED * self.period * limits.velocity + DISTANCE)
                return [here]
            path = [Place(start)]
        path = [*path[-3:], here]
        velocity = np.abs(here.position - path[-2].position) / (self.period * steps)
        slack = 2 * quantum / self.period
        self._within("velocity", velocity, limits.velocity * (1 + ROUNDING) + slack, now.stopped)
        if len(path) > 2:
            speeds = [
                (place.position - last.position) / (self.period * place.steps)
                for last, place in zip(path[-3:-1], path[-2:], strict=True)
            ]
            lasts = self.period * (path[-1].steps + path[-2].steps) / 2
            allowed = limits.acceleration * lasts * (1 + ROUNDING) + 2 * slack
            self._within("acceleration", np.abs(speeds[1] - speeds[0]), allowed, now.stopped)
        if len(path) > 3 and self.jerk is not None:
            self._jerk([place.position for place in path])
        # An arm that is outside its range is not told to go further.
        lower = np.minimum(limits.position_min, path[-2].position) - quantum
        upper = np.maximum(limits.position_max, path[-2].position) + quantum
        assert (now.stopped | (here.position >= lower)).all(), "range"
        assert (now.stopped | (here.position <= upper)).all(), "range"
        return path[-3:]

    def _jerk(self, path):
        """Check the jerk of four set-points, but for joints that could not stop in time with it.

        Those have less way left than a stop takes at most: the speed of now and what the last
        acceleration adds to it while it fades, for as long as it takes to brake and to change that.
        """
        limits, h, jerk = self.limits, self.period, self.jerk
        speed, change = (path[2] - path[1]) / h, (path[2] - 2 * path[1] + path[0]) / h**2
        third = np.abs(path[3] - 3 * path[2] + 3 * path[1] - path[0])
        allowed = jerk * h**3 * (1 + ROUNDING) + 8 * self.quanta.position
        fast = np.abs(speed) + change**2 / (2 * jerk)
        lasts = fast / limits.acceleration + 2 * limits.acceleration / jerk + 3 * h
        ends = np.where(speed > 0, limits.position_max, limits.position_min)
        bound = (ends - path[2]) * np.sign(speed) <= fast * lasts
        assert ((third <= allowed) | bound).all(), f"jerk {(third / allowed)[~bound].max():.4g}"

    def _torques(self, now, state, anew, steps):
        """Return what is left of the torque, or what it is."""
        q, v, before = state.position, state.velocity, self.before
        quantum, most = self.quanta.torque, self.limits.torque

        def effort(item, position):
            total = item.stiffness * (position - q) + item.damping * (item.velocity - v)
            return np.clip(total + item.torque, -most, most)

        last = self.fade
        if before is not None and before.mode == TORQUE:
            last = before.torque
            if now.mode == TORQUE:
                last = last + before.carried - now.carried
        elif before is not None and before.mode == IMPEDANCE:
            place = before.position if anew or now.mode != IMPEDANCE else now.position
            last = effort(before, place)
        if now.mode == POSITION:
            return np.sign(last) * np.maximum(np.abs(last) - self.step, 0.0)
        self._within(
            "torque", np.abs(now.torque + now.carried), most * (1 + ROUNDING) + quantum, now.stopped
        )
        if self.sure:
            there = effort(now, now.position) if now.mode == IMPEDANCE else now.torque
            rate = np.abs(there - last) / (self.step * steps)
            # Both sides of the comparison are rounded on the wire.
            for item in (now, before) if self._sprung(now) else ():
                if item is not None and item.mode == IMPEDANCE:
                    away, speed = np.abs(item.position - q), np.abs(item.velocity - v)
                    quantum = quantum + self.quanta.stiffness * away
                    quantum = quantum + self.quanta.damping * speed
                    quantum = quantum + item.stiffness * self.quanta.position
                    quantum = quantum + item.damping * self.quanta.velocity
            if self.gains is not None and before is not None:
                quantum = quantum + np.abs(now.carried - before.carried)
            slack = (quantum + self.quanta.torque) / self.step
            self._within("torque rate", rate, 1 + ROUNDING + slack, now.stopped)
        return now.torque
