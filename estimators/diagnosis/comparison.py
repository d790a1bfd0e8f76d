"""Comparison: is one simulation better than another on a recording, at which joints, and why not?

Both are held against the measured torque behind one zero-phase filter, on all samples but those at
the ends of stretches, where derivatives are unsure. Estimates that the arm's maker recorded are
compared as well.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.diagnosis.held_out import block_length, blocks_of_time, rmse_change
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.model.units import unit_of
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import AFTER, BEFORE, FLOOR, joint_errors
from limo_driver.pages.markup import columns, header, listed, next_steps, section
from limo_driver.physics.effect import ArmMotion, TorqueEffect
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.runtime.display import Displayed
from limo_driver.runtime.outputs import require_folder, whole

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from limo_driver.physics import Effect, Simulation
    from limo_driver.physics.domain import Domain
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

FILES: Final = ("evaluation.json", "report.html")
BETTER, WORSE, EQUAL, UNKNOWN = "better", "worse", "no different", "not measured"
BODIES: Final = "the inertias of links"
ESTIMATE: Final = "estimate"  # of the measured torque, by the arm's maker
EXTERNAL: Final = "external_torque"  # what the maker takes for no torque of the arm's own


@dataclass(frozen=True)
class Culprit:
    """What of the improved simulation makes a joint worse."""

    part: str  # effect and joints, or the bodies
    by: float  # RMSE that the joint would lose, were that part as in the given simulation [N m]
    outside: float | None = None  # part of the samples beyond its domain; None if it has none

    def in_words(self, unit: str) -> str:
        """Say what it is and how much it costs, in the unit of its joint."""
        beyond = f", beyond its domain in {self.outside:.0%} of the samples" if self.outside else ""
        return f"{self.part} by {self.by:.3g} {unit}{beyond}"


@dataclass(frozen=True, repr=False)
class SimulationComparison(Displayed):
    """Errors of an improved and of the given simulation on a recording of n joints."""

    recording: str
    joint_names: tuple[str, ...]
    given: FloatArray  # RMSE, (n,) [N m]; NaN for joints whose torque was not measured
    improved: FloatArray  # likewise
    low: FloatArray  # 95 % interval of improved less given, (n,) [N m]
    high: FloatArray
    culprits: tuple[tuple[Culprit, ...], ...]  # of each joint that is worse, the worst first
    estimates: Mapping[str, FloatArray]  # RMSE of estimates that were recorded, (n,) [N m]
    samples: int
    bandwidth: float  # [Hz]
    sliding: tuple[bool, ...] = ()  # (n,), joints in m and N; empty if all turn

    @property
    def states(self) -> tuple[str, ...]:
        """Whether each joint is better, worse or neither, beyond its interval."""
        return tuple(
            UNKNOWN if np.isnan(a) else BETTER if high < 0 else WORSE if low > 0 else EQUAL
            for a, low, high in zip(self.given, self.low, self.high, strict=True)
        )

    @property
    def worse(self) -> tuple[int, ...]:
        """Joints, 1-based, that are worse beyond their intervals."""
        return tuple(j for j, state in enumerate(self.states, start=1) if state == WORSE)

    def headline(self) -> str:
        """Say at how many joints the improved simulation is better, and where it is worse."""
        count = Counter(self.states)
        better, judged = count[BETTER], len(self.states) - count[UNKNOWN]
        worse = f", worse at {', '.join(self._names(self.worse))}" if self.worse else ""
        of = f" of {self.recording}" if self.recording else ""
        return (
            f"better at {better} of {judged} joints{worse}, over {self.samples} samples{of}, "
            f"torque filtered at {self.bandwidth:g} Hz"
        )

    @property
    def unit(self) -> str:
        """Of the joints' torques: N of those that slide."""
        return unit_of("N m", self.sliding)

    def _names(self, joints: Sequence[int]) -> list[str]:
        return [self.joint_names[j - 1] for j in joints]

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the errors of each joint, the change with its interval, and what it is."""
        unit = self.unit
        named = {f"{name} [{unit}]": values.tolist() for name, values in self.estimates.items()}
        ends = zip(self.low.tolist(), self.high.tolist(), strict=True)
        return {
            "joint": self.joint_names,
            f"RMSE given [{unit}]": self.given.tolist(),
            f"improved [{unit}]": self.improved.tolist(),
            f"change [{unit}]": (self.improved - self.given).tolist(),
            "95 % interval": [f"{low:+.3g} to {high:+.3g}" for low, high in ends],
            "is": self.states,
            **named,
        }

    def reasons(self) -> Iterator[str]:
        """Yield why the improved simulation is worse, one sentence for each joint where it is."""
        for j in self.worse:
            found, name = self.culprits[j - 1], self.joint_names[j - 1]
            unit = unit_of("N m", self.sliding, j - 1)
            parts = "; ".join(item.in_words(unit) for item in found)
            yield f"{name} is worse because of {parts or 'no part alone: they act together'}."

    def __str__(self) -> str:
        return "\n".join([super().__str__(), *self.reasons()])

    def as_values(self) -> dict[str, Any]:
        """Return the figures as JSON values; None where they are not known."""
        intervals = np.stack([self.low, self.high], axis=1)
        return {
            "schema": 1,
            "recording": self.recording,
            "bandwidth": self.bandwidth,
            "samples": self.samples,
            "joints": list(self.joint_names),
            "state": list(self.states),
            "rmse_given": _known(self.given),
            "rmse_improved": _known(self.improved),
            "change_ci95": [_known(ends) for ends in intervals],
            "worse_because": [[vars(item) for item in found] for found in self.culprits],
            "estimates": {name: _known(values) for name, values in self.estimates.items()},
        }

    def save(self, folder: Path | str) -> None:
        """Write evaluation.json and report.html; the folder is made.

        Raises:
            ConfigError: The folder cannot be written to.
        """
        require_folder(Path(folder), "the evaluation", FILES)
        values = json.dumps(self.as_values(), indent=1) + "\n"
        for name, text in zip(FILES, (values, _page(self).html()), strict=True):
            with whole(Path(folder) / name) as draft:
                draft.write_text(text, encoding="utf-8")


def _known(values: FloatArray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]


def _page(found: SimulationComparison) -> Page:
    """Return the page of a comparison."""
    charts = Charts()
    source = (
        "RMSE: root mean square of measured minus predicted torque, behind one zero-phase filter. "
        "The interval is that of the change, by resampled blocks of time."
    )
    title = f"The improved simulation is {found.headline()}."
    again = "limo diagnose RECORDING --sim GIVEN --out diagnosis/"
    body = (
        header("Comparison of two simulations", title, source)
        + section("Errors", _errors(found, charts), "errors")
        + section("Why it is worse", listed(found.reasons()), "why")
        + next_steps([("Where it is worse, let the diagnosis see this motion, too.", again)])
    )
    return Page(title, body, charts, sliding=found.sliding)


def _errors(found: SimulationComparison, charts: Charts) -> str:
    errors = [
        *((name, values, "diamond-open", FLOOR) for name, values in found.estimates.items()),
        ("given", found.given, "circle-open", BEFORE),
        ("improved", found.improved, "circle", AFTER),
    ]
    chart = joint_errors(errors, found.joint_names, found.unit)
    return charts.place(chart, "Error of each joint") + columns(dict(found.figures()))


def compare_simulations(
    improved: Simulation,
    given: Simulation,
    recording: Recording,
    estimate: str = ESTIMATE,
    external: str = EXTERNAL,
) -> SimulationComparison:
    """Compare two simulations of an arm on a recording that neither was fitted to.

    Args:
        improved: The one that may be better.
        given: The other.
        recording: T samples of n joints of that arm.
        estimate: What of the recording is an estimate of its torque: columns of that name.
        external: What of it is taken for external, so that the estimate is the rest: likewise.

    Raises:
        ConfigError: The simulations are of arms with other joints, or named columns are not there.
        RecordingError: It is of another arm, has no torque, or is too short.
    """
    if improved.model.joint_names != given.model.joint_names:
        raise ConfigError(
            f"`against` is of the joints {', '.join(given.model.joint_names)}, expected those of "
            f"`sim`: {', '.join(improved.model.joint_names)}"
        )
    recording.check_torque()
    recording.check_robot(improved.model)
    bandwidth = bandwidth_for([recording])
    scored = recording.scored(bandwidth)
    measured = recording.measured_torque(bandwidth)

    def errors(simulation: Simulation) -> FloatArray:
        predicted = recording.filtered(simulation.predict(recording, bandwidth), bandwidth)
        return (measured - predicted)[scored]

    motion = recording.calm_motion(bandwidth)

    def outside(part: ComparedPart) -> float | None:
        if part.domain is None:
            return None
        own = ArmMotion(motion, np.zeros_like(motion.position), improved.model)
        return float(part.domain.outside(own.of_joint(part.joints[0] - 1))[scored].mean())

    first, second = errors(given), errors(improved)
    rows = np.isfinite(first)
    time, alone = recording.time[scored], np.zeros(len(first), dtype=np.int64)
    block = blocks_of_time(time, alone, block_length(recording))
    low, high = rmse_change(first, second, block, rows)
    before, after = _rmse(first), _rmse(second)
    worse = (low > 0) & np.isfinite(before)
    return SimulationComparison(
        recording.source,
        improved.model.joint_names,
        before,
        after,
        low,
        high,
        tuple(
            _culprits(
                improved, given, j, float(after[j]), lambda trial: _rmse(errors(trial)), outside
            )
            if is_worse
            else ()
            for j, is_worse in enumerate(worse.tolist())
        ),
        {
            name: _rmse(values[scored])
            for name, values in _estimates(recording, measured, bandwidth, estimate, external)
        },
        int(scored.sum()),
        bandwidth,
        improved.model.sliding,
    )


def _rmse(errors: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(errors**2, axis=0))


def _estimates(
    recording: Recording, measured: FloatArray, bandwidth: float, estimate: str, external: str
) -> Iterator[tuple[str, FloatArray]]:
    """Yield what recorded estimates leave of the torque, by name, (T, n) [N m]."""
    for name, usual, is_rest in ((estimate, ESTIMATE, False), (external, EXTERNAL, True)):
        if (values := recording.extras.get(name)) is None:
            if name == usual:
                continue
            exist = ", ".join(sorted(recording.extras)) or "none"
            raise RecordingError(
                f"has no columns {name}_1 … {name}_{recording.n} of an estimate; such columns "
                f"that it has: {exist}",
                path=recording.source or None,
            )
        filtered = recording.filtered(values, bandwidth)
        left = filtered if is_rest else measured - filtered
        yield name, np.where(np.isnan(measured), np.nan, left)


def _culprits(
    improved: Simulation,
    given: Simulation,
    joint: int,
    error: float,
    rmse: Callable[[Simulation], FloatArray],
    outside: Callable[[ComparedPart], float | None],
) -> tuple[Culprit, ...]:
    """Return the parts without which a joint (0-based) errs less, the worst first."""
    found = [
        Culprit(part.name, error - float(rmse(part.without)[joint]), outside(part))
        for part in parts_of(improved, given)
        if not part.joints or joint + 1 in part.joints
    ]
    return tuple(sorted((c for c in found if c.by > 0), key=lambda c: -c.by))


@dataclass(frozen=True)
class ComparedPart:
    """What two simulations have otherwise at one place: effects, or the inertias of links."""

    name: str
    joints: tuple[int, ...]  # 1-based, at which it acts; empty if on the whole arm
    without: Simulation  # the improved one, with this part as given
    domain: Domain | None = None  # in which it was learned
    place: str = ""  # of its effects, as a simulation names it


def parts_of(improved: Simulation, given: Simulation) -> Iterator[ComparedPart]:
    """Yield the parts in which an improved simulation differs from the given one."""
    ours, theirs = _by_place(improved), _by_place(given)
    for place in dict.fromkeys([*ours, *theirs]):
        own, other = ours.get(place, ()), theirs.get(place, ())
        if own != other:
            at = improved.effects.index(own[0]) if own else len(improved.effects)
            before, after = (
                tuple(effect for effect in some if effect not in own)
                for some in (improved.effects[:at], improved.effects[at:])
            )
            trial = replace(improved, effects=(*before, *other, *after))
            domains = (effect.domain for effect in own if isinstance(effect, TorqueEffect))
            joints = (own or other)[0].joints
            yield ComparedPart(place.replace("_", " "), joints, trial, next(domains, None), place)
    if improved.inertials != given.inertials:
        yield ComparedPart(BODIES, (), replace(improved, inertials=given.inertials))


def widths_of(improved: Simulation, given: Simulation) -> Iterator[ComparedPart]:
    """Yield the widths of the sign of dry friction that was stated, and that differ."""
    stated = {effect.place: effect for effect in given.effects}
    for k, effect in enumerate(improved.effects):
        before = stated.get(effect.place)
        for known in effect.parameters() if before else ():
            if not known.smooths or getattr(before, known.name) == getattr(effect, known.name):
                continue
            as_given = replace(effect, **{known.name: getattr(before, known.name)})
            effects = (*improved.effects[:k], as_given, *improved.effects[k + 1 :])
            name = f"{known.name} of {effect.place.replace('_', ' ')}"
            trial = replace(improved, effects=effects)
            yield ComparedPart(name, effect.joints, trial, place=effect.place)


def _by_place(simulation: Simulation) -> dict[str, tuple[Effect, ...]]:
    found: dict[str, tuple[Effect, ...]] = {}
    for effect in simulation.effects:
        found[effect.place] = (*found.get(effect.place, ()), effect)
    return found
