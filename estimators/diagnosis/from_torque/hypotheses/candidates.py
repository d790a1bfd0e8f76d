"""Candidates: hypotheses with their columns in the table, ready to compete."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from estimators.diagnosis.from_torque.hypotheses import catalogue as hypotheses
from estimators.diagnosis.from_torque.hypotheses.catalogue import (
    derivative,
    mover,
    relative_inertia,
    reviser,
    sharpener,
)
from estimators.diagnosis.from_torque.hypotheses.responses import (
    beyond,
    payload_of,
    responses,
    stacked,
)
from estimators.diagnosis.settings import MATTERS, TINY
from estimators.diagnosis.settings.fitting import CANDIDATES, REVISION, RIPPLE
from estimators.regression.evidence import Prior
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.errors import ConfigError
from limo_driver.physics import CoulombFriction, TorqueGain, ViscousFriction
from limo_driver.physics.catalogue import description_of, known_as

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.hypotheses.responses import Enter, Improvement, Response
    from estimators.diagnosis.from_torque.residuals.noise import ColumnTable
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.model import RobotModel
    from limo_driver.physics import Effect, Hypothesis, Simulation
    from limo_driver.types import FloatArray

BASE = (CoulombFriction.name, ViscousFriction.name)  # what every joint has


@dataclass(frozen=True)
class LawEvidence:
    """One law at its best settings."""

    law: str  # in words
    log_evidence: float  # less what its settings cost [nat]


@dataclass(frozen=True)
class Candidate:
    """One effect at one place, with its columns."""

    effect: str
    joints: tuple[int, ...]  # 0-based; empty for the whole arm
    kind: Literal["missing", "wrong_parameter"]
    prior: Prior
    enter: Enter
    hypothesis: Hypothesis | None = None
    prior_penalty: float = CANDIDATES.missing  # [nat] it has to bring before it is believed
    variants: int = 1  # with how many of its kind it shares its chance
    other_width: bool = False  # acts over another width than is stated, which a sibling does
    laws: tuple[LawEvidence, ...] = ()  # of which the hypothesis is the best, once they competed

    @property
    def place(self) -> tuple[str, tuple[int, ...]]:
        """Name of the candidate: effect and joints."""
        return self.effect, self.joints

    @property
    def persists(self) -> bool:
        """Whether another recording has it, too, so that the improved simulation does."""
        known = known_as(self.effect)
        return known is None or known.persists

    @property
    def price(self) -> float:
        """What it has to bring before it is believed, the chance of many of its kind included."""
        return self.prior_penalty + float(np.log(self.variants))

    @cached_property
    def slot(self) -> tuple[str, tuple[int, ...]]:
        """Slot that holds at most one candidate of a set, since others there would be redundant."""
        return description_of(self.effect).part_of or self.effect, self.joints


def candidates_of(
    observed: Observations, columns: ColumnTable, level: FloatArray
) -> list[Candidate]:
    """Add the columns of every hypothesis to the table.

    Args:
        observed: Recordings and simulation.
        columns: The table; the nuisance columns are in it.
        level: Plausible RMS of a missing torque on each joint, (n,) [N m].
    """
    found = [*_revisions(observed, columns, level), *_bodies(observed, columns)]
    revised = {candidate.place for candidate in found}
    untold = _of_no_scale(observed)
    competing = [
        hypothesis
        for hypothesis in hypotheses.every(observed)
        if (hypothesis.effect, hypothesis.joints) not in revised
        and not (hypothesis.effect == TorqueGain.name and hypothesis.joints[0] in untold)
    ]
    for start in range(0, len(competing), RIPPLE.block):
        some = competing[start : start + RIPPLE.block]
        parts = iter(responses([term for item in some for term in item.terms], observed))
        for hypothesis in some:
            own = [next(parts) for _ in hypothesis.terms]
            candidate = _enter_columns(hypothesis, own, columns, level)
            if candidate is not None:
                found.append(candidate)
    bare, usual = without_friction(observed.simulation), _usual(observed.simulation)
    return _counted([replace(item, prior_penalty=_rarity(item, bare, usual)) for item in found])


def _of_no_scale(observed: Observations) -> set[int]:
    """Return the joints (0-based) at which a gain is no hypothesis.

    Where gains are tolerated, it is a value that is known to that; and friction that nothing is
    stated of has a size of its own, in the scale of the sensor. Where most of a joint's torque is
    that, a gain would pass for the friction, and nothing known tells it.
    """
    if observed.simulation.tolerances.gain:
        return set(range(observed.n))
    bare = without_friction(observed.simulation)
    own = {(j + 1,) for j in bare}
    around = observed.reference
    known = tuple(
        effect for effect in around.effects if not (effect.is_friction and effect.joints in own)
    )
    if len(known) == len(around.effects):
        return set()
    all_of, rest = observed.predicted, observed.predict(replace(around, effects=known))
    size, friction = (np.sqrt(np.mean(part**2, axis=0)) for part in (rest, all_of - rest))
    return {j for j in bare if friction[j] > size[j]}


def without_friction(simulation: Simulation) -> tuple[int, ...]:
    """Return the joints (0-based) that a simulation gives no friction of any kind."""
    known = {
        joint for effect in simulation.effects if effect.is_friction for joint in effect.joints
    }
    return tuple(j for j in range(simulation.model.n) if j + 1 not in known)


def _rarity(candidate: Candidate, bare: Sequence[int], usual: set[str]) -> float:
    """Return what a candidate has to bring before it is believed [nat].

    A joint rubs, whether that is stated or not. And what most joints are stated to have, the
    others may have, too.

    Args:
        candidate: The candidate.
        bare: Joints (0-based) of which no friction is stated.
        usual: Effects that most joints are stated to have.
    """
    if candidate.effect in BASE and candidate.joints[0] in bare:
        return 0.0
    return CANDIDATES.missing / 2 if candidate.effect in usual else candidate.prior_penalty


def _usual(simulation: Simulation) -> set[str]:
    """Return the effects that most joints are stated to have."""
    stated: dict[str, set[int]] = {}
    for effect in simulation.effects:
        stated.setdefault(effect.name, set()).update(effect.joints)
    most = 0.5 * simulation.model.n
    return {name for name, joints in stated.items() if len(joints) > most}


def _counted(found: Sequence[Candidate]) -> list[Candidate]:
    count = Counter((candidate.place, candidate.other_width) for candidate in found)
    return [replace(item, variants=count[item.place, item.other_width]) for item in found]


def entered(
    hypothesis: Hypothesis, observed: Observations, columns: ColumnTable, level: FloatArray
) -> Candidate | None:
    """Add one hypothesis' columns to the table; None if it can have no influence."""
    return _enter_columns(hypothesis, responses(hypothesis.terms, observed), columns, level)


def _enter_columns(
    hypothesis: Hypothesis, found: Sequence[Response], columns: ColumnTable, level: FloatArray
) -> Candidate | None:
    joints, values = stacked(found, columns.rows)
    relative = np.sqrt(np.mean(values**2, axis=1)) / level[list(joints), None]
    strength = relative.max(axis=0)
    if strength.min() < TINY:
        strength = np.maximum(strength, TINY)
        if strength.max() <= TINY:
            return None
    if hypothesis.is_list:
        # a place that the motion hardly passed has little torque, which is no reason for its value
        # to be anything
        least = MATTERS * strength.max()
        strength = np.where(strength > TINY, np.maximum(strength, least), strength)
    deviation = np.where(strength > TINY, 1.0 / strength, 0.0)
    return Candidate(
        hypothesis.effect,
        hypothesis.joints,
        "missing",
        Prior(
            columns.add(joints, values),
            deviation,
            np.full(deviation.size, hypothesis.positive),
            most=hypothesis.most * strength,
        ),
        lambda improvement, c: improvement.enter(hypothesis, c),
        hypothesis,
    )


def _revisions(
    observed: Observations, columns: ColumnTable, level: FloatArray
) -> Iterator[Candidate]:
    """Yield every effect of the simulation, with its parameters free.

    They may change by all that they are, or by what makes a plausible torque, if that is more: a
    gain or an offset that is nearly zero in the simulation may be anything on the arm. How sharp a
    sign is, is guessed: a change of dry friction may be as sharp as it is stated, or other than so.
    """
    for place, effect in enumerate(observed.simulation.effects):
        parameters = effect.parameters()
        sizes = [
            known
            for known in parameters
            if known.is_size and not known.smooths and getattr(effect, known.name)
        ]
        if not sizes:
            continue
        parts = [derivative(observed, effect, known.name) for known in sizes]
        yield _revised(effect, parts, reviser(place, sizes), columns, level)
        widths = [
            (known, float(np.clip(times * getattr(effect, known.name), known.lower, known.upper)))
            for known in parameters
            if known.smooths and getattr(effect, known.name)
            for times in CANDIDATES.sharper
        ]
        for sharp, width in widths:
            turned = effect.with_value(sharp.name, width)
            parts = [derivative(observed, turned, known.name) for known in sizes]
            enter = sharpener(place, sizes, sharp, width)
            yield replace(_revised(effect, parts, enter, columns, level), other_width=True)


def _revised(
    effect: Effect,
    parts: Sequence[Response],
    enter: Enter,
    columns: ColumnTable,
    level: FloatArray,
) -> Candidate:
    """Return an effect of the simulation with c parameters free, which act as `parts` say."""
    joints, values = stacked(parts, columns.rows)
    relative = np.sqrt(np.mean(values**2, axis=1)) / level[list(joints), None]
    deviation = np.maximum(1.0, 1.0 / np.maximum(relative.max(axis=0), TINY))
    return Candidate(
        effect.name,
        tuple(joint - 1 for joint in effect.joints),
        "wrong_parameter",
        Prior.free(columns.add(joints, values), deviation),
        enter,
        prior_penalty=CANDIDATES.missing / 2,
    )


def _bodies(observed: Observations, columns: ColumnTable) -> Iterator[Candidate]:
    """Yield every link and a payload, each as large as can be expected, and much smaller.

    A body has ten parameters. Were each expected to be large, a small one would have to bring ten
    times what one parameter has to, and tolerances at their limits would do as well.
    """
    model, n, Y = observed.simulation.model, observed.n, observed.regressor
    for joint, link in enumerate(model.linkage.own.tolist()):
        scale = relative_inertia(model.inertials[model.link_names[link]])
        many = model.linkage.felt_by(link)
        own = Y[:many, :, PER_LINK * link : PER_LINK * (link + 1)]
        index = columns.add(range(many), own @ scale)
        for part in CANDIDATES.parts_of_body:
            deviation = np.full(PER_LINK, part * CANDIDATES.wrong_inertia)
            prior = Prior.free(index, deviation)
            yield Candidate("link_inertia", (joint,), "wrong_parameter", prior, mover(link, scale))
    index = columns.add(range(n), np.ascontiguousarray(Y[:, :, -PER_LINK:]))
    largest, has_mass = _payload_prior(model), np.arange(PER_LINK) == 0
    whole = np.zeros(PER_LINK, dtype=np.int64)  # without mass it is no load
    for part in CANDIDATES.parts_of_body:
        prior = Prior(index, part * largest, has_mass, whole)
        yield Candidate("payload", (n - 1,), "missing", prior, _loader)


def _payload_prior(model: RobotModel) -> FloatArray:
    """Return 1 sigma of (m, m c, I) of a payload in the frame of the last link, (10,).

    A load is at the end of that link, which is about twice as far from the joint as its centre is.
    """
    bodies = [model.inertials[name] for name in model.link_names]
    farthest = float(np.linalg.norm(bodies[-1].com))  # all that a single joint has of length
    mass = CANDIDATES.payload * sum(body.mass for body in bodies)
    around = CANDIDATES.payload * (model.length + farthest)
    lever = max(around, 2.0 * farthest, REVISION.least_lever)
    return np.repeat([mass, mass * lever, mass * lever**2], (1, 3, 6))


def _loader(improvement: Improvement, c: FloatArray) -> None:
    """Add a payload; one whose mass is at its bound of 0 is none.

    Raises:
        ConfigError: It would have to be farther away than a load can be.
    """
    if c[0] <= 0:
        return
    load = payload_of(c)
    if improvement.extents and beyond(improvement.extents, load):
        raise ConfigError("a payload has to be within reach of the last link")
    improvement.add(load)
