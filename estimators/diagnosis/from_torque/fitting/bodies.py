"""Bodies: a fit of links and of a payload, drawn to the nearest ones that can be.

The torque is linear in mass, first moments and inertia of a body, and a linear fit knows no bounds:
what little the motion shows of an inertia may come out as one that no body has, and what no body
explains as one whose mass is where the arm is not. It is drawn to the body that exists, lies within
the extent of its link, and whose torque is nearest, in units of what the fit leaves at each joint;
what else was fitted follows to keep that torque, as far as the fit leaves it open. Nearest in the
metric of the fit would be another body: under noise that is predicted from one row to the next, a
slow error of several newton metres costs less than a quick one of a tenth, and gravity would give
way to what little is known of an inertia.

What competes for a name knows no bounds, either. Where a body wins whose mass would be out of
reach, its name is worth as much less as its set loses on the way to the nearest one that can be, in
the metric in which it won. One that is merely no body costs its name nothing: what little motion
shows of an inertia is impossible as often as not, and says nothing against a load.

Source: Wensing, Kim and Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", RA-L 2018.

Rotation: residuals of rows that were held out in turn, so that all of a recording can judge.

Whether a gain is sure asks for many blocks of time. Friction that builds up shows at reversals, and
the blocks held out of a short recording have but one or two of these. So each block is held out
once, but the first and the last, and a set is fitted to what is left. Its settings, which the
torque is not linear in, stay: they were refined on other rows than the proof's.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_solve

from estimators.diagnosis.from_torque.hypotheses.catalogue import relative_inertia
from estimators.diagnosis.from_torque.hypotheses.responses import body_of
from estimators.diagnosis.from_torque.residuals.noise import ColumnTable, normal_equations
from estimators.diagnosis.headline import LINK_INERTIA
from estimators.diagnosis.held_out import Split
from estimators.diagnosis.settings.residuals import HELD_OUT
from estimators.regression.definite import inverse_root, lower_of
from estimators.regression.evidence import REACH, Prior, joined, posterior
from estimators.rigid_body.fitting.consistent import nearest_body
from estimators.rigid_body.regressor import PER_LINK, parameters_of
from limo_driver.errors import DivergedError
from limo_driver.physics import Payload

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate
    from estimators.diagnosis.from_torque.residuals.noise import Noise
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.regression.evidence import NormalEquations, Posterior
    from estimators.rigid_body.fitting.extent import Extent, Extents
    from limo_driver.model import RobotModel
    from limo_driver.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class _Body:
    """A body with the coefficients of a fit that act on it."""

    nominal: FloatArray  # (10,)
    changes: FloatArray  # (10, m) what coefficients add
    own: IntArray  # (10,) the coefficients that are drawn with it
    extent: Extent
    member: int | None  # place in the set of the candidate that it is, if it is one

    def fitted(self, mean: FloatArray) -> FloatArray:
        """Return its parameters (10,) under coefficients (m,)."""
        return self.nominal + self.changes @ mean

    def is_free(self, fit: Posterior) -> bool:
        """Say whether a fit held no coefficient, and each of them moves a parameter of its own."""
        own = np.diag(self.changes[:, self.own])  # on and below which all of them are
        return bool(own.all() and fit.deviation[self.own].all())

    def is_impossible(self, mean: FloatArray) -> bool:
        """Say whether it is there and cannot be; where the nominal one cannot, nobody knows."""
        body = self.fitted(mean)
        if not body.any() or self._can_be(body):
            return False
        return not self.nominal.any() or self._can_be(self.nominal)

    def is_out_of_reach(self, mean: FloatArray) -> bool:
        """Say whether its mass would be where the arm is not, and the nominal one is not there."""
        outside = not self.extent.holds(self.fitted(mean))
        return outside and self.extent.holds(self.nominal)

    def _can_be(self, parameters: FloatArray) -> bool:
        body = body_of(parameters)
        return body is not None and body.is_consistent() and self.extent.holds(parameters)


def with_possible_bodies(
    model: RobotModel,
    extents: Extents,
    members: Sequence[Candidate],
    nuisance: Prior,
    fitted: Posterior,
    torques: Callable[[Prior], FloatArray],
) -> FloatArray:
    """Return the coefficients (m,) of a fit, moved so that every body can exist.

    Args:
        model: The nominal bodies; one that is itself impossible is left as it is fitted.
        extents: In which their mass lies.
        members: The set that was fitted.
        nuisance: Prior of the coefficients that come first.
        fitted: Coefficients of the nuisance, bodies first, then of the set.
        torques: Returns products (m, m) of the torques of all of them, beside their prior.
    """
    mean, prior = fitted.mean.copy(), joined(nuisance, *(item.prior for item in members))
    known = cache(partial(torques, prior))
    drawn: list[IntArray] = []
    for item in _bodies(model, extents, members, mean.size):
        if not item.is_impossible(mean):
            continue
        if not item.is_free(fitted):
            continue  # held in part, where the nearest cannot be told
        own, body = item.own, item.fitted(mean)
        back = np.linalg.inv(item.changes[:, own]).astype(np.float64)
        metric = back.T @ known()[np.ix_(own, own)] @ back
        try:
            nearest = nearest_body(body, metric, item.extent)
        except DivergedError:
            continue  # whoever writes it down makes it a body that can be
        mean[own] += back @ (nearest - body)
        drawn.append(own)
    if not drawn:
        return mean
    moved = np.concatenate(drawn)
    open_to = np.diag(fitted.covariance)
    rest = np.setdiff1d(np.flatnonzero(open_to > 0), moved)
    change = known()[np.ix_(rest, moved)] @ (mean - fitted.mean)[moved]
    stiff = known()[np.ix_(rest, rest)] + np.diag(1.0 / open_to[rest])
    mean[rest] -= cho_solve((lower_of(stiff), True), change)
    most = np.where(np.arange(mean.size) < nuisance.index.size, REACH * prior.deviation, np.inf)
    return np.clip(mean, np.where(prior.positive, 0.0, -most), most)


def lost_by_bodies(
    model: RobotModel, extents: Extents, members: Sequence[Candidate], found: Posterior
) -> dict[int, float]:
    """Return what a set loses where a body out of reach is the nearest one that can be [nat].

    Args:
        model: The nominal bodies.
        extents: In which their mass lies.
        members: The set that competed.
        found: Its coefficients, as they competed.

    Returns:
        By place in the set, nothing of bodies within reach: how much likelier the set is than it
        would be had it competed with one that can be.
    """
    lost: dict[int, float] = {}
    for item in _bodies(model, extents, members, found.mean.size):
        if item.member is None or not item.is_out_of_reach(found.mean):
            continue
        if not item.is_free(found):
            continue
        root = inverse_root(item.changes @ found.covariance @ item.changes.T)
        metric, body = root.T @ root, item.fitted(found.mean)
        possible = [item.nominal]  # as if it had not competed
        with suppress(DivergedError):
            start = item.nominal if item.nominal.any() else None
            possible.append(nearest_body(body, metric, item.extent, start))
        lost[item.member] = min(0.5 * float((x - body) @ metric @ (x - body)) for x in possible)
    return lost


def _bodies(
    model: RobotModel, extents: Extents, members: Sequence[Candidate], size: int
) -> Iterator[_Body]:
    """Yield the bodies on which coefficients (m,) act, those of a set with or without a nuisance.

    A payload is a body of its own, since the simulation has it beside the link that carries it. Of
    one that is stated, only the mass may be another.
    """
    links = [model.inertials[name] for name in model.link_names]
    changes = [np.zeros((PER_LINK, size)) for _ in links]
    last = [PER_LINK * link + np.arange(PER_LINK) for link in range(len(links))]
    owner: dict[int, int] = {}
    at = size - sum(candidate.prior.index.size for candidate in members)
    for link, body in enumerate(links if at else ()):
        changes[link][:, last[link]] = relative_inertia(body)  # bodies come first
    for place, candidate in enumerate(members):
        own = at + np.arange(candidate.prior.index.size)
        if candidate.effect == LINK_INERTIA:
            link = int(model.linkage.own[candidate.joints[0]])
            changes[link][:, own] = relative_inertia(links[link])
            last[link], owner[link] = own, place
        elif candidate.effect == Payload.name and candidate.kind == "missing":
            alone = np.zeros((PER_LINK, size))
            alone[:, own] = np.eye(PER_LINK)
            yield _Body(np.zeros(PER_LINK), alone, own, extents.of(len(links) - 1), place)
        at += own.size
    for link, body in enumerate(links):
        nominal = parameters_of(body)
        yield _Body(nominal, changes[link], last[link], extents.of(link), owner.get(link))


@dataclass
class Rotation:
    """Sums over the rows that are fitted in each turn, of some columns under one noise."""

    noise: Noise
    splits: tuple[Split, ...]
    columns: ColumnTable  # those of the nuisance first, then others
    place: dict[int, int]  # of a column of the whole table, among these
    nuisance: Prior  # of these columns
    target: FloatArray  # (K, n) [N m]
    sums: tuple[NormalEquations, ...]
    _left: dict[tuple[bytes, bytes], FloatArray] = field(
        default_factory=dict[tuple[bytes, bytes], "FloatArray"], init=False
    )

    @classmethod
    def of(
        cls,
        observed: Observations,
        columns: ColumnTable,
        target: FloatArray,
        noise: Noise,
        nuisance: Prior,
        others: IntArray,
    ) -> Rotation:
        """Sum over the rows of each turn.

        Args:
            observed: Recordings and simulation.
            columns: The table.
            target: What the columns have to sum up to, (K, n) [N m].
            noise: Of each joint.
            nuisance: Columns that are in every set.
            others: Further columns that sets may have, (c,).
        """
        index = np.unique(np.concatenate([nuisance.index, others]))
        some = columns.only(index)
        place = {int(column): k for k, column in enumerate(index)}
        own = replace(nuisance, index=_placed(place, nuisance.index))
        blocks = ([block + turn for block in HELD_OUT.which] for turn in (-1, 0, 1))
        splits = tuple(Split.of(observed, which) for which in blocks)
        sums = tuple(
            normal_equations(some, target, noise.over(split.fitted, observed.segment), split.fitted)
            for split in splits
        )
        return cls(noise, splits, some, place, own, target, sums)

    @property
    def held_out(self) -> BoolArray:
        """Mark the rows (K, n) that are held out in some turn."""
        return np.any([split.held_out for split in self.splits], axis=0)

    def has(self, noise: Noise, index: IntArray) -> bool:
        """Say whether these are sums of some columns (c,), under that noise."""
        return self.noise is noise and all(int(column) in self.place for column in index)

    def left(self, prior: Prior) -> FloatArray:
        """Return what a set of columns leaves of rows held out, (K, n) [N m]; 0 elsewhere."""
        own = replace(prior, index=_placed(self.place, prior.index))
        key = own.index.tobytes(), own.deviation.tobytes()
        if key not in self._left:
            result = np.zeros_like(self.target)
            for split, sums in zip(self.splits, self.sums, strict=True):
                fitted = posterior(sums, self.nuisance, own)
                rest = self.target - self.columns.apply(fitted.index, fitted.mean)
                result = np.where(split.held_out, rest, result)
            self._left[key] = result
        return self._left[key]


def _placed(place: dict[int, int], index: Sequence[int] | IntArray) -> IntArray:
    return np.array([place[int(column)] for column in index], dtype=np.int64)
