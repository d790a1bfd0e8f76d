"""Verdict: result of a diagnosis, as values and as `verdict.json`."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

from estimators.diagnosis.settings import LITTLE, NEARLY_ALL, Z95
from estimators.regression.evidence import REACH
from limo_driver.model.units import unit_of
from limo_driver.physics import ArmEffect, BodyEffect, display_name
from limo_driver.physics.catalogue import known_as
from limo_driver.runtime import written_by
from limo_driver.runtime.display import call_joints, joints_called
from limo_driver.runtime.outputs import plain_json, whole

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

SCHEMA = 1
CONTACT = "external_contact"
VERDICT = "verdict.json"  # the files of a diagnosis, in one folder
IMPROVED = "sim.yaml"
REPORT = "report.html"
NEXT_MOTION = "next_motion.parquet"
TORQUE = "N m"  # unit of errors where torque was recorded
LINK_INERTIA = "link_inertia"  # what a body of the simulation has wrong; no effect of its own
UNKNOWN = "unknown"  # the effect of a mismatch that nothing in the catalogue explains

Summary: TypeAlias = Literal["consistent", "explained", "partly_explained", "unexplained"]
State: TypeAlias = Literal[
    "agrees", "stated values differ", "physics is missing", "something unexplained remains"
]
Value: TypeAlias = "float | str | tuple[Value, ...]"


@dataclass(frozen=True)
class Interval:
    """A fitted parameter; lists have one interval per entry."""

    value: Value
    unit: str
    ci95: tuple[Any, ...] | None = None  # (lower, upper), or one pair per entry; None for texts
    stated: float | None = None  # what the simulation has, of which the value is beyond tolerances


@dataclass(frozen=True)
class Where:
    """Region and time in which a mismatch shows."""

    time: tuple[tuple[float, float], ...] = ()  # [s], stretches, in the time of each recording
    region: str = ""  # in words: speeds, positions, loads
    figure: str = ""  # anchor in the report
    recording: tuple[int, ...] = ()  # 1-based, in which recording each stretch is


@dataclass(frozen=True)
class Finding:
    """One effect that was left out of the simulation, or has a wrong parameter there."""

    effect: str
    kind: Literal["missing", "wrong_parameter"]
    joints: tuple[int, ...]  # 1-based
    equivalent: tuple[str, ...]  # effects that these recordings cannot distinguish from it
    confidence: float  # calibrated probability that effect and joints are right
    parameters: Mapping[str, Interval]
    where: Where
    share: float  # of the error that tolerances leave: what it takes; of `unknown`: what stays
    heldout_rmse: BeforeAfter
    evidence: str  # one sentence
    signs: Mapping[str, float] = field(default_factory=dict)  # what the confidence is made of


@dataclass(frozen=True)
class Identified:
    """Ordinary physics of a joint of which the simulation states none: a value, and no finding."""

    effect: str
    joint: int  # 1-based
    parameters: Mapping[str, Interval] = field(default_factory=dict)

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint, as a finding has them."""
        return (self.joint,)


@dataclass(frozen=True)
class StatedValue:
    """A value that the given simulation states, and the one that fits the recordings.

    Where only several values together are known, as masses and centres of links are, they are a
    family, and its value is the RMS torque that they make at a joint, over the rows that count.
    """

    name: str  # as a `sim.yaml` has it, or what the family is of
    effect: str  # that has it; "" of a family
    joints: tuple[int, ...]  # 1-based, at which it acts; of a family, at which it is felt
    joint_names: tuple[str, ...]  # of those, as the description has them
    unit: str
    stated: float
    fitted: float
    ci95: tuple[float, float] | None = None
    tolerance: float | None = None  # standard deviation that the simulation allows [unit]
    assumed: bool = False  # whether nobody stated that tolerance, which is limo's guess then
    beyond: bool = False  # whether it moved beyond what that tolerance allows
    reported: bool = False  # it differs for sure, and takes a tenth of a joint's error or more
    share: float = 0.0  # of the reducible error of the joint where it takes most

    @property
    def moved(self) -> bool:
        """Whether the stated value is outside the 95 % interval, or is reported."""
        outside = self.ci95 is not None and not self.ci95[0] <= self.stated <= self.ci95[1]
        return self.reported or self.beyond or outside or self.is_taken

    @property
    def is_taken(self) -> bool:
        """Whether the improved simulation has another value, which the motion does not show."""
        if self.ci95 is not None or not self.tolerance or self.stated <= 0.0 or self.fitted <= 0.0:
            return False
        return abs(math.log(self.fitted / self.stated)) > REACH * self.tolerance / self.stated

    @property
    def in_words(self) -> str:
        """The value with its joint and effect, as what a motion hardly shows is named."""
        place = f" of joint {self.joints[0]}" if self.joints else ""
        return f"{self.name}{place} ({display_name(self.effect)})"

    @property
    def is_known_well(self) -> bool:
        """Whether recordings leave less open than a tolerance does."""
        if self.ci95 is None or self.tolerance is None:
            return False
        return self.ci95[1] - self.ci95[0] < 2.0 * Z95 * NEARLY_ALL * self.tolerance


@dataclass(frozen=True)
class BeforeAfter:
    """Held-out RMSE of each joint without and with a finding, (n,) [N m]."""

    before: tuple[float, ...]
    after: tuple[float, ...]


@dataclass(frozen=True)
class Unexplained:
    """Residual that no effect of the catalogue explains."""

    joints: tuple[int, ...] = ()  # 1-based
    share: tuple[float, ...] = ()  # of what tolerances leave at each of them, the part that stays
    where: Where = field(default_factory=Where)


@dataclass(frozen=True)
class NotObservable:
    """An effect that these recordings do not excite enough to detect."""

    effect: str
    reason: str


@dataclass(frozen=True)
class NextMotion:
    """The motion in which the effects of each pair would differ."""

    separates: tuple[tuple[str, str], ...]
    file: str


@dataclass(frozen=True)
class Fit:
    """Held-out errors before and after, and how much of the reducible error is removed.

    Reducible is the mean square of the given simulation's error there beyond that of the noise
    floor, summed over joints. Values that move inside their tolerances may take most of it; the
    shares of findings are of what those leave (`heldout_rmse_tolerances`), and add up to 1 at most.

    Rows near rest, at reversals, under a push or in a jolt do not count: `RowCount` says how many
    are left, and `..._all_rows` what the errors are with them.
    """

    heldout_rmse_before: tuple[float, ...]  # (n,) [N m]
    heldout_rmse_after: tuple[float, ...]
    noise_floor: tuple[float, ...]
    reducible_error_removed: float
    ci95: tuple[float, float]
    heldout_rmse_tolerances: tuple[float, ...] = ()  # values moved inside tolerances, no effect
    heldout_rmse_before_all_rows: tuple[float, ...] = ()  # (n,) [N m], every row held out
    heldout_rmse_after_all_rows: tuple[float, ...] = ()
    above_floor: tuple[int, ...] = ()  # joints, 1-based, at which as given surely more than noise
    still_above: tuple[int, ...] = ()  # those of the improved simulation
    left_out: str = ""  # motion on which was proven what is written, in words
    unit: str = TORQUE  # of all errors; rad where commands and positions alone were recorded
    one_step_rmse_before: tuple[float, ...] = ()  # (n,) [rad], from each row to the next; likewise
    one_step_rmse_after: tuple[float, ...] = ()
    inverse_dynamics_rmse_before: tuple[float, ...] = ()  # (n,) [N m], of drive and friction
    inverse_dynamics_rmse_after: tuple[float, ...] = ()

    @property
    def worse_within_tolerances(self) -> tuple[int, ...]:
        """Joints, 1-based, on which values moved inside their tolerances do clearly worse.

        They are fitted to other rows, to all joints at once, and whitened: without the effects that
        are missing, they bend towards those, and a joint may pay for what another gains.
        """
        pairs = zip(self.heldout_rmse_before, self.heldout_rmse_tolerances, strict=False)
        return tuple(
            j for j, (given, moved) in enumerate(pairs, start=1) if moved > (1 + LITTLE) * given
        )


_Placed = TypeVar("_Placed", Finding, Unexplained)


@dataclass(frozen=True)
class RowCount:
    """Rows: samples of all recordings, and rows of the slow grid, on which all is compared."""

    used: int  # samples
    left_out: Mapping[str, int]  # samples, by reason
    total: int = 0  # rows of the slow grid
    usable: tuple[int, ...] = ()  # (n,) of them not near rest, nor under a push or in a jolt
    fitted: tuple[int, ...] = ()  # (n,) of those, that parameters were fitted to
    held_out: int = 0  # rows in the blocks of time that nothing was fitted to
    judged: tuple[int, ...] = ()  # (n,) of those, usable: the errors of `Fit` count these

    def part_judged(self) -> tuple[float, ...]:
        """Return the part of the rows held out that counts, of each joint (n,)."""
        return tuple(count / max(self.held_out, 1) for count in self.judged)


@dataclass(frozen=True)
class Holds:
    """Motion on which a verdict stands: rows that count, by joint (n,), as (least, largest).

    On other motion, the improved simulation extrapolates.
    """

    position: tuple[tuple[float, float], ...]  # [rad]
    speed: tuple[tuple[float, float], ...]  # [rad/s], of either sign
    load: tuple[tuple[float, float], ...]  # [N m], of the rigid body as stated
    as_stated: tuple[str, ...] = ()  # friction that the motion says next to nothing of


@dataclass(frozen=True)
class Verdict:
    """The result of a diagnosis; `save` writes `verdict.json`."""

    verdict: Summary
    findings: tuple[Finding, ...]
    unexplained: Unexplained
    not_observable: tuple[NotObservable, ...]
    next_motion: NextMotion | None
    fit: Fit
    rows: RowCount
    notes: tuple[str, ...] = ()  # what a reader should know of data and priors, one sentence each
    identified: tuple[Identified, ...] = ()  # ordinary friction that was not stated, by joint
    holds: Holds | None = None  # None where no torque was recorded
    withheld: tuple[str, ...] = ()  # parts of the fit that are not in the improved simulation
    doubts: tuple[str, ...] = ()  # those of the notes that make all of it doubtful
    values: tuple[StatedValue, ...] = ()  # stated ones, and those that fit
    joint_names: tuple[str, ...] = ()  # (n,), as the description has them
    sliding: tuple[bool, ...] = ()  # (n,), joints in m and N; empty if all turn

    def __post_init__(self) -> None:
        """Let sentences, which count joints, call them as the description does."""

        def named(text: str) -> str:
            return call_joints(text, self.joint_names)

        def placed(item: _Placed) -> _Placed:
            return replace(item, where=replace(item.where, region=named(item.where.region)))

        found = (placed(replace(x, evidence=named(x.evidence))) for x in self.findings)
        hidden = (replace(x, reason=named(x.reason)) for x in self.not_observable)
        vars(self).update(
            findings=tuple(found),
            unexplained=placed(self.unexplained),
            not_observable=tuple(hidden),
            notes=tuple(map(named, self.notes)),
            doubts=tuple(map(named, self.doubts)),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all joints, (n,); empty texts where nobody has written them down."""
        return self.joint_names or ("",) * len(self.fit.noise_floor)

    @property
    def is_of_torque(self) -> bool:
        """Whether torque was recorded; else errors are of positions."""
        return not self.fit.one_step_rmse_before

    def unit_at(self, joint: int) -> str:
        """Return the unit of the errors of a joint (1-based)."""
        if not any(self.sliding) or all(self.sliding):
            return self.fit.unit
        return unit_of(TORQUE if self.is_of_torque else "rad", self.sliding, joint - 1)

    @property
    def labels(self) -> tuple[str, ...]:
        """Joints as tables call them, (n,): `3 (stick)`, or `3` alone where names say no more."""
        return joints_called(self.names)

    @property
    def states(self) -> tuple[State, ...]:
        """What holds between simulation and recordings, in words; the first stands alone."""
        found: dict[State, bool] = {
            "stated values differ": any(item.reported and item.stated for item in self.values)
            or any(item.kind == "wrong_parameter" for item in self.findings),
            "physics is missing": any(item.reported and not item.stated for item in self.values)
            or any(map(self.is_missing, self.findings))
            or bool(self.not_stated),
            "something unexplained remains": bool(self.unexplained_joints),
        }
        return tuple(name for name, holds in found.items() if holds) or ("agrees",)

    def is_missing(self, item: Finding) -> bool:
        """Say whether a finding is of physics that the given simulation states nothing of."""
        return item.kind == "missing" and item.effect != UNKNOWN and not any(self.values_of(item))

    def values_of(self, item: Finding) -> tuple[StatedValue, ...]:
        """Return the stated values that a finding changes, and that are reported."""
        return tuple(
            value
            for value in self.values
            if value.reported
            and value.effect == item.effect
            and (value.joints == item.joints or not value.joints)
        )

    @property
    def not_stated(self) -> tuple[int, ...]:
        """Joints, 1-based, above the noise floor, whose ordinary physics the simulation lacks."""
        stated = {(value.effect, value.joints) for value in self.values}
        lacking = {x.joint for x in self.identified if (x.effect, x.joints) not in stated}
        return tuple(sorted(lacking & {*self.fit.above_floor}))

    @property
    def hardly_shown(self) -> tuple[str, ...]:
        """Stated friction that the motion says next to nothing of, and that did not move."""
        known = {item.in_words for item in self.values if item.moved or item.is_known_well}
        return tuple(x for x in (self.holds.as_stated if self.holds else ()) if x not in known)

    @property
    def unexplained_joints(self) -> tuple[int, ...]:
        """Joints, 1-based, with an error that nothing explains or accounts for.

        The latter are above the noise floor as given, no finding or value acts there, and they
        stay above it; or nothing at all is found that could account for it.
        """
        found = (*self.findings, *(item for item in self.values if item.reported))
        acting = {j for item in found for j in (item.joints or self.fit.above_floor)}
        if any(is_felt_by_all(item.effect) for item in self.findings):
            acting |= {*self.fit.above_floor}
        open_ = {*self.fit.above_floor} - acting - {*self.not_stated}
        if found or self.not_stated:
            open_ &= {*self.fit.still_above}
        unknown = {j for x in self.findings if x.effect == UNKNOWN for j in x.joints}
        return tuple(sorted(open_ | unknown | {*self.unexplained.joints}))

    def as_values(self) -> dict[str, Any]:
        """Return the content of `verdict.json`: plain lists, texts and numbers; NaN as null."""
        content = plain_json(asdict(self))
        for item in (*content["findings"], *content["identified"]):
            for known in item["parameters"].values():
                if known["stated"] is None:
                    del known["stated"]
        if self.holds is not None:
            content["holds"]["as_stated"] = list(self.hardly_shown)
        content["unexplained"]["joints"] = list(self.unexplained.joints)
        for name in [x for x in content["fit"] if x.startswith(("one_step", "inverse_dynamics"))]:
            if not content["fit"][name]:  # torque was recorded
                del content["fit"][name]
        if not any(self.sliding):
            del content["sliding"]
        return {"schema": SCHEMA} | content | {"states": list(self.states)}

    def save(self, path: Path) -> None:
        """Write `verdict.json`.

        Raises:
            ConfigError: It cannot be written.
        """
        content = {written_by.KEY: written_by.installed()} | self.as_values()
        with whole(path) as draft:
            draft.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def is_felt_by_all(effect: str) -> bool:
    """Say whether an effect may act on all joints, whichever it is of."""
    known = known_as(effect)
    return effect == LINK_INERTIA or (
        known is not None and issubclass(known, (BodyEffect, ArmEffect))
    )
