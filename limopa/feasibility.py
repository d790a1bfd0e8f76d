"""Feasibility of configurations and paths: joint limits, workspace, table, self-collision.

Source: checkFeasibility and cartesianSampleRange of Algorithm 1 (LIMOPA) of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import ConfigError, InfeasiblePathError
from limo_driver.model.descriptions.shapes import Capsule, ShapeDistances
from limo_driver.model.kinematics import KinematicChain
from limopa.distances import clearances

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from limo_driver.model import RobotModel
    from limo_driver.types import BoolArray, FloatArray
    from limopa.path import Path
    from limopa.request import Surroundings, Workspace

ALWAYS = 0.95  # of random configurations; a pair that is near in more is so by construction
NEAR = 0.02  # [m], as near as capsules around neighbouring shapes come
ROUNDING = 1e-9  # [rad]
_SLIDE_MARGIN = 0.1  # of the range of a joint that slides, kept at most from either end
WAY_OUT = "self-collision checks can be switched off (`Surroundings.self_collision`)"
_LISTED = 4  # links that a message names
_FIRST = 8, 64  # samples of a path that are looked at first, and then
_PARTS = 8  # of the others
PROBES = 1000  # random configurations that show which pairs do


class Condition(StrEnum):
    """Conditions on a configuration or a path."""

    JOINT_LIMITS = "joint limits"
    WORKSPACE = "effective workspace"
    TABLE = "table"
    SELF_COLLISION = "self-collision"


@dataclass(frozen=True)
class Violations:
    """Violations of each condition by T configurations; each array has shape (T,)."""

    broken: Mapping[Condition, BoolArray]

    @property
    def feasible(self) -> BoolArray:
        """Configurations that break no condition, (T,)."""
        return ~np.logical_or.reduce(list(self.broken.values()))

    def conditions(self) -> tuple[Condition, ...]:
        """Return the conditions that any configuration breaks."""
        return tuple(name for name, rows in self.broken.items() if rows.any())


class Feasibility:
    """Check configurations and paths of one robot in given surroundings.

    Links are convex shapes: capsules, and where those come too near, what they are around, the
    hulls of meshes. Neighbours in the chain are not checked against each other, nor are pairs
    that touch in nearly every configuration, since their shapes overlap by construction
    (`overlapping_pairs`). The base and the first link stand on the table and are not checked
    against it. Without self-collision the joint frames and the flange are kept off the table.

    Raises:
        ConfigError: The collision shapes cannot be read, or a joint has no limit of velocity, or
            limits of 0 to 0.
        InfeasiblePathError: The joint margin leaves a joint no range.
    """

    def __init__(self, model: RobotModel, surroundings: Surroundings, workspace: Workspace) -> None:
        self.surroundings, self.workspace = surroundings, workspace
        self.chain = KinematicChain.of(model)
        _require_limits(model)
        self._slides = np.array(model.sliding)
        room = _SLIDE_MARGIN * (model.limits.position_max - model.limits.position_min)
        self.margin = np.where(
            self._slides, np.minimum(surroundings.clearance, room), surroundings.joint_margin
        )
        self.lower = model.limits.position_min + self.margin
        self.upper = model.limits.position_max - self.margin
        empty = np.flatnonzero(self.lower >= self.upper)
        if empty.size:
            raise InfeasiblePathError(
                Condition.JOINT_LIMITS,
                f"a margin of {np.degrees(self.surroundings.joint_margin):g} deg at either end "
                f"leaves joint {empty[0] + 1} no range (`joint_margin`)",
            )
        self.capsules = self._bodies(model)
        self._joint = np.array([body.joint for body in self.capsules])
        self._ends = np.array([[body.start, body.end] for body in self.capsules])
        self._radius = np.array([body.radius for body in self.capsules])
        self._above_table = self._joint > 0
        self.overlapping_pairs: tuple[tuple[str, str], ...] = ()
        self._pairs = np.zeros((0, 2), dtype=np.int64)
        self._exact: ShapeDistances | None = None
        if surroundings.self_collision:
            self._choose_pairs(model)
        self._reach = self._reaches()

    def check(self, position: FloatArray, *, all_of: bool = True) -> Violations:
        """Check joint limits, table and self-collision of joint positions (T, n) [rad].

        Args:
            position: (T, n) [rad].
            all_of: Whether everything that a configuration breaks is asked for, not only whether it
                breaks anything, which takes less time.
        """
        outside = np.any(
            (position < self.lower - ROUNDING) | (position > self.upper + ROUNDING), axis=1
        )
        table, touching = np.zeros_like(outside), np.zeros_like(outside)
        rows = np.full_like(outside, True) if all_of else ~outside
        gap, lowest = self.clearances(position[rows], all_of=all_of)
        need = self.surroundings.clearance
        table[rows] = np.any(lowest < self.surroundings.table_height + need, axis=1)
        touching[rows] = np.any(gap < need, axis=1)
        return Violations(
            {
                Condition.JOINT_LIMITS: outside,
                Condition.TABLE: table,
                Condition.SELF_COLLISION: touching,
            }
        )

    def check_scaffold(self, position: FloatArray, *, all_of: bool = True) -> Violations:
        """Check joint positions (T, n) [rad] as `check` does, and the effective workspace."""
        outside = self.outside(position) > 0
        near = np.full_like(outside, True) if all_of else ~outside
        found = self.check(position[near], all_of=all_of).broken
        broken = {Condition.WORKSPACE: outside}
        for condition, rows in found.items():
            broken[condition] = np.zeros_like(outside)
            broken[condition][near] = rows
        return Violations(broken)

    def outside(self, position: FloatArray) -> FloatArray:
        """Return how far the flange is outside the effective workspace, (T,) [m]; 0 inside."""
        space = self.workspace
        flange = self.chain.flange_position(position)
        box = np.maximum(np.array(space.lower) - flange, flange - np.array(space.upper))
        beyond = np.linalg.norm(flange - np.array(space.centre), axis=1) - space.radius
        return np.maximum(np.linalg.norm(np.maximum(box, 0.0), axis=1), np.maximum(beyond, 0.0))

    def turned_to(self, start: FloatArray, position: FloatArray) -> FloatArray:
        """Return poses with each joint as near as whole turns bring it, (T, n) [rad].

        Args:
            start: To which they are to be near, (n,) [rad].
            position: (T, n) [rad].
        """
        turn = np.where(self._slides, np.inf, 2.0 * np.pi)
        turns = np.clip(
            np.round((start - position) / turn),
            np.ceil((self.lower - position) / turn),
            np.floor((self.upper - position) / turn),
        )
        return np.where(self._slides, position, position + 2.0 * np.pi * turns)

    def margins(self, position: FloatArray) -> FloatArray:
        """Return the margin of every distance at joint positions (T, n) [rad], (T, m) [m].

        Negative where a pair of links or the table is too near, or the flange is outside the
        effective workspace.
        """
        gap, lowest = self.clearances(position)
        need, space = self.surroundings.clearance, self.workspace
        flange = self.chain.flange_position(position)
        lower, upper = np.array(space.lower), np.array(space.upper)
        left = [
            gap - need,
            lowest - self.surroundings.table_height - need,
            (flange - lower)[:, np.isfinite(lower)],
            (upper - flange)[:, np.isfinite(upper)],
        ]
        if np.isfinite(space.radius):
            far = np.linalg.norm(flange - np.array(space.centre), axis=1, keepdims=True)
            left.append(space.radius - far)
        return np.concatenate(left, axis=1)

    def blocked(self, position: FloatArray) -> tuple[Condition, str] | None:
        """Return what no motion of the joints can mend, as far as configurations show it.

        A link in the table, or two links in each other, in all of them, and by more than the
        distance varies among them.

        Args:
            position: Random configurations, (T, n) [rad].

        Returns:
            The condition, and who breaks it, with the argument that asks for it; None if nothing
            is so.
        """
        gap, lowest = self.clearances(position)
        table, need = self.surroundings.table_height, self.surroundings.clearance
        if stuck := _hopeless(lowest - table - need):
            bodies = np.flatnonzero(self._above_table)[stuck]
            links = _listed(dict.fromkeys(self.capsules[k].link for k in bodies))
            reason = f"{links} cannot be lifted off the table at {table:g} m (`table_height`)"
            if not _hopeless(lowest - table):
                reason = f"{links} cannot be kept {need:g} m off the table (`clearance`)"
            return Condition.TABLE, reason
        if stuck := _hopeless(gap - need):
            names = [(self.capsules[i].link, self.capsules[k].link) for i, k in self._pairs[stuck]]
            pairs = dict.fromkeys(f"{one} and {other}" for one, other in names)
            apart = f"{_listed(pairs)} cannot be kept {need:g} m apart (`clearance`)"
            return Condition.SELF_COLLISION, apart
        return None

    def check_path(self, path: Path) -> tuple[Condition, ...]:
        """Return conditions that a path breaks, those that are found first; empty if feasible.

        Samples lie so close that no point of the arm moves by more than the clearance from one to
        the next. What lies between two samples therefore keeps at least half of the clearance.
        A few are looked at before, since a path that is blocked mostly is so for long.
        """
        check = self.check_scaffold if self.workspace.throughout else self.check

        def broken(s: FloatArray) -> tuple[Condition, ...]:
            return check(path.derivative(s, 0), all_of=False).conditions()

        for few in _FIRST:
            if found := broken(np.linspace(0.0, path.length, few)):
                return found
        travel = path.length * float(path.peaks()[0] @ self._reach)  # [m]
        count = int(np.ceil(travel / self.surroundings.clearance)) + 2
        samples = np.linspace(0.0, path.length, count)
        for part in range(_PARTS):
            if found := broken(samples[part::_PARTS]):
                return found
        return ()

    def clearances(
        self, position: FloatArray, *, all_of: bool = True
    ) -> tuple[FloatArray, FloatArray]:
        """Return the gap of each pair (T, c) and the lowest point of each body (T, m) [m].

        Of those that are not too near, the gap between the capsules around them, which is less.

        Args:
            position: (T, n) [rad].
            all_of: False: where one distance is too small, others that may be are infinite.
        """
        chain = self.chain
        gap, lowest = clearances(
            np.ascontiguousarray(chain.linkage.positions(position)),
            chain.parent,
            chain.rotation,
            chain.translation,
            chain.axis,
            self._joint,
            self._ends,
            self._radius,
            self._pairs,
        )
        if self._exact is not None:
            need = self.surroundings.clearance
            floor = self.surroundings.table_height + need
            low = np.where(self._above_table, floor, -np.inf)
            self._exact.sharpen(position, gap, lowest, need, low, all_of=all_of)
        return gap, lowest[:, self._above_table]

    def _bodies(self, model: RobotModel) -> tuple[Capsule, ...]:
        if not self.surroundings.self_collision:
            origin = np.zeros(3)
            frames = [
                Capsule(name, j, origin, origin, 0.0) for j, name in enumerate(model.link_names)
            ]
            flange = Capsule(
                "flange", model.linkage.links - 1, self.chain.flange, self.chain.flange, 0.0
            )
            return (*frames, flange)
        try:
            bodies = model.capsules()
        except ConfigError as error:
            raise ConfigError(f"{str(error).rstrip('.')}; {WAY_OUT}") from None
        if not any(body.joint > 0 for body in bodies):
            raise ConfigError(
                f"has no collision shapes on its moving links; {WAY_OUT}",
                path=model.urdf,
            )
        return bodies

    def _choose_pairs(self, model: RobotModel) -> None:
        joint = self._joint
        candidates = [
            (i, k) if joint[i] < joint[k] else (k, i)
            for i in range(len(joint))
            for k in range(i)
            if joint[i] != joint[k]
        ]
        apart = [(i, k) for i, k in candidates if self.chain.parent[joint[k]] != joint[i]]
        self._pairs = np.array(sorted(apart), dtype=np.int64).reshape(-1, 2)
        self._exact = ShapeDistances(model.shapes, self._pairs)
        probes = np.random.default_rng(0).uniform(self.lower, self.upper, (PROBES, len(self.lower)))
        near = min(self.surroundings.clearance, NEAR)
        touching = (self.clearances(probes)[0] < near).mean(axis=0)
        always = touching > ALWAYS
        links = [(self.capsules[i].link, self.capsules[k].link) for i, k in self._pairs[always]]
        self.overlapping_pairs = tuple(dict.fromkeys(links))  # a link may have several capsules
        self._pairs = np.ascontiguousarray(self._pairs[~always])
        self._exact = ShapeDistances(model.shapes, self._pairs)

    def _reaches(self) -> FloatArray:
        """Return a bound of how far anything moves with each joint, (n,) [m/rad, m/m].

        Of a joint that turns, that is how far from its axis anything it moves can be.
        """
        linkage = self.chain.linkage
        farthest = [np.abs(linkage.positions(ends)) for ends in (self.lower, self.upper)]
        slid = np.maximum(*farthest)
        reach = np.zeros(linkage.links)
        for body, ends, radius in zip(self.capsules, self._ends, self._radius, strict=True):
            if body.joint >= 0:
                extent = float(np.linalg.norm(ends, axis=1).max() + radius)
                reach[body.joint] = max(reach[body.joint], extent)
        for j in range(linkage.links - 1, -1, -1):
            above = self.chain.parent[j]
            if above >= 0:
                offset = float(np.linalg.norm(self.chain.translation[j]))
                if self.chain.slides[j]:
                    offset += float(slid[j])
                reach[above] = max(reach[above], offset + reach[j])
        moved = np.abs(linkage.ratio) * np.where(self.chain.slides, 1.0, reach)
        return np.bincount(linkage.driver, moved, linkage.n).astype(np.float64)


def _hopeless(margin: FloatArray) -> list[int]:
    """Return the columns, of (T, m) [m], that are negative by more than they vary."""
    if not margin.size:
        return []
    best, worst = margin.max(axis=0), margin.min(axis=0)
    return np.flatnonzero(best + (best - worst) < 0).tolist()


def _listed(names: Iterable[str]) -> str:
    first, more = (found := list(names))[:_LISTED], len(found) - _LISTED
    return ", ".join(first) + (f" and {more} more" if more > 0 else "")


def _require_limits(model: RobotModel) -> None:
    model.check_ranges()
    unknown = np.flatnonzero(model.limits.velocity <= 0)
    if unknown.size:
        raise ConfigError(
            f"joint {unknown[0] + 1} ({model.joint_names[unknown[0]]}) has no limit of velocity, "
            "so no motion of it can be planned: give it one in its description",
            path=model.urdf,
        )
