"""Score verdicts on concealed cases against what was hidden.

A finding names a hidden effect if it, or an effect that either side calls indistinguishable from
it, is that effect, at one of its joints. A class is one row of `FAMILIES`.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from math import inf, nan
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnosis_closure import Closure, closure
from scipy.stats import beta

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

FAMILIES = {
    "rigid body": ("link_inertia", "payload", "gravity_direction", "armature"),
    "friction over speed": (
        "coulomb_friction", "asymmetric_friction", "viscous_friction", "stribeck_friction",
        "quadratic_drag",
    ),
    "friction over distance": ("presliding_hysteresis",),
    "friction over load, pose, heat": (
        "load_dependent_friction", "position_dependent_friction",
        "temperature_dependent_friction",
    ),
    "transmission": ("backlash", "joint_elasticity", "torque_ripple"),
    "sensor": (
        "torque_offset", "torque_gain", "torque_crosstalk", "torque_drift", "encoder_offset",
        "time_delay",
    ),
    "surroundings": ("external_contact", "spring_load"),
    "coupling": ("joint_coupling",),
    "unknown": ("unknown",),
}  # fmt: skip
_FAMILY = {effect: family for family, effects in FAMILIES.items() for effect in effects}
UNKNOWN = "unknown"
BINS = 10


@dataclass(frozen=True)
class Judged:
    """One case: what was hidden, what was said, how well it foretells."""

    case: Path
    truth: dict[str, Any]
    verdict: dict[str, Any] | None  # None: the command failed
    closure: Closure | None
    closure_near_rest: Closure | None  # over all moving rows, those near rest included
    seconds: float

    @property
    def findings(self) -> list[dict[str, Any]]:
        """Return the findings, those with the largest share first."""
        found = self.verdict["findings"] if self.verdict else []
        return sorted(found, key=lambda f: -(f.get("share") or 0.0))

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Return what was hidden."""
        return list(self.truth["effects"])

    @property
    def size(self) -> float:
        """Return the nominal size of a single effect."""
        return float((self.truth["asked"] or [0.0])[0])

    @property
    def all_named(self) -> bool:
        """Whether everything hidden is named."""
        return all(any(names(f, e) for f in self.findings) for e in self.effects)

    @property
    def exactly_right(self) -> bool:
        """Whether everything hidden is named, and nothing else."""
        extra = [f for f in self.findings if not any(names(f, e) for e in self.effects)]
        return self.verdict is not None and self.all_named and not extra

    @property
    def classes_right(self) -> bool:
        """Whether the set of classes named is that of the classes hidden."""
        said = {self._family(f) for f in self.findings}
        return said == {_FAMILY[e["effect"]] for e in self.effects}

    def _family(self, finding: dict[str, Any]) -> str:
        for effect in self.effects:
            if same_effect(finding, effect):
                return _FAMILY[effect["effect"]]
        return _FAMILY.get(finding["effect"], finding["effect"])

    @property
    def abstained(self) -> bool:
        """Whether `unknown` is said."""
        silent = self.verdict is None or self.verdict["verdict"] == "unexplained"
        return silent or any(f["effect"] == UNKNOWN for f in self.findings)

    def unknown_at(self, joints: Sequence[int]) -> bool:
        """Whether something unexplained is said to be at one of `joints`."""
        verdict = self.verdict or {}
        said = set(verdict.get("unexplained", {}).get("joints") or [])
        said |= {j for f in self.findings if f["effect"] == UNKNOWN for j in f["joints"]}
        return bool(said & set(joints))


def same_effect(finding: dict[str, Any], effect: dict[str, Any]) -> bool:
    """Whether a finding and a hidden effect go by one name, or cannot be told apart."""
    said, hidden = finding["effect"], effect["effect"]
    listed = finding.get("equivalent") or ()
    return said == hidden or said in effect["equivalent"] or hidden in listed


def names(finding: dict[str, Any], effect: dict[str, Any]) -> bool:
    """Whether a finding names a hidden effect, at its joints and no other."""
    said, true = set(finding["joints"]), set(effect["joints"])
    placed = not said or (bool(said) and said <= true)
    bodies = {"payload", "link_inertia", "gravity_direction", "external_contact"}
    whole = effect["effect"] in bodies and finding["effect"] in bodies - {"link_inertia"}
    return same_effect(finding, effect) and (placed or whole)


def judge(case: Path, out: str = "out") -> Judged:
    """Read one finished case."""
    truth = json.loads((case / "hidden" / "truth.json").read_text())
    result = json.loads((case / out / "result.json").read_text())
    path = case / out / "verdict.json"
    verdict = json.loads(path.read_text()) if result["status"] == 0 and path.exists() else None
    seconds = float(result["seconds"])
    return Judged(case, truth, verdict, closure(case, out), closure(case, out, 0.0), seconds)


@dataclass(frozen=True)
class Line:
    """One line of the result."""

    what: str
    value: str
    bar: str


def score(judged: Sequence[Judged]) -> list[Line]:
    """Return every line of the bar."""
    kinds = {kind: [c for c in judged if c.truth["kind"] == kind] for kind in (
        "null", "single", "set", "unknown", "wrong_parameter")}  # fmt: skip
    nulls, singles = kinds["null"], kinds["single"]
    known = [c for c in (*singles, *kinds["set"], *kinds["wrong_parameter"]) if c.size >= 3 or
             c.truth["kind"] != "single"]  # fmt: skip
    lines = [rate("false alarm on nulls", [bool(c.findings) or c.verdict is None for c in nulls],
                  "<= 2 %")]  # fmt: skip
    for size in sorted({c.size for c in singles}):
        at = [c for c in singles if c.size == size]
        bars = (">= 98 %", ">= 90 %") if size >= 3 else ("", "")
        lines += [
            rate(f"single {size:g}x: right class", [_main_class(c) for c in at], bars[0]),
            rate(f"single {size:g}x: exact name and joint", [_main_exact(c) for c in at], bars[1]),
        ]
    lines += [
        rate("sets: exact set of classes", [c.classes_right for c in kinds["set"]], ">= 85 %"),
        rate("sets: all names and joints", [c.all_named for c in kinds["set"]], ""),
        rate("wrong parameter: named", [c.all_named for c in kinds["wrong_parameter"]], ""),
        rate("unknown said to be unknown, at its joint", [_unknown(c) for c in kinds["unknown"]],
             ">= 90 %"),
        rate("false abstention", [c.abstained and not c.all_named for c in known], "<= 5 %"),
        rate("cases exactly right", [c.exactly_right for c in known], ">= 85 %"),
        *_calibration(judged),
        *_closures(known),
        _times(judged),
        Line("command failed", f"{sum(c.verdict is None for c in judged)} of {len(judged)}", "0"),
    ]  # fmt: skip
    return lines


def _main_class(case: Judged) -> bool:
    if not case.findings:
        return False
    main, effect = case.findings[0], case.effects[0]
    return same_effect(main, effect) or _FAMILY.get(main["effect"]) == _FAMILY[effect["effect"]]


def _main_exact(case: Judged) -> bool:
    return bool(case.findings) and names(case.findings[0], case.effects[0])


def _unknown(case: Judged) -> bool:
    effect = case.effects[0]
    accepted = any(names(f, effect) for f in case.findings if f["effect"] != UNKNOWN)
    return accepted or case.unknown_at(effect["joints"])


def rate(what: str, hits: Sequence[bool], bar: str) -> Line:
    """Return a share with its Clopper-Pearson interval."""
    k, n = sum(hits), len(hits)
    if not n:
        return Line(what, "no case", bar)
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return Line(what, f"{k / n:6.1%}  ({k} of {n}; {low:.1%} to {high:.1%})", bar)


def _calibration(judged: Iterable[Judged]) -> list[Line]:
    said: list[tuple[float, bool]] = []
    covered: list[bool] = []
    listed: list[int] = []
    for case in judged:
        for finding in case.findings:
            matched = [e for e in case.effects if names(finding, e)]
            said.append((float(finding["confidence"]), bool(matched)))
            listed.append(len(finding.get("equivalent") or ()))
            for effect in matched:
                covered += coverage(finding, effect)
    error = f"{calibration_error(said):.3f}  ({len(said)} findings)" if said else "no finding"
    return [
        Line(f"calibration error of the confidence, {BINS} bins", error, "<= 0.05"),
        rate("coverage of 95 % intervals", covered, "92 to 98 %"),
        Line("equivalents listed per finding", f"{np.mean(listed):.2f}" if listed else "-", ""),
    ]


def calibration_error(said: Sequence[tuple[float, bool]]) -> float:
    """Return the mean gap between confidence and correctness over bins, weighted by their rows."""
    confidence, right = (np.array(x, float) for x in zip(*said, strict=True))
    at = np.minimum((confidence * BINS).astype(int), BINS - 1)
    gaps = [abs(float((confidence - right)[at == b].sum())) for b in range(BINS)]
    return sum(gaps) / len(said)


def coverage(finding: dict[str, Any], effect: dict[str, Any]) -> list[bool]:
    """Return, for each scalar parameter that both sides have, whether the interval holds it."""
    if finding["effect"] != effect["effect"]:
        return []
    held: list[bool] = []
    for name, true in effect["parameters"].items():
        said = finding.get("parameters", {}).get(name)
        if said is None or isinstance(true, list) or not said.get("ci95"):
            continue
        low, high = said["ci95"]
        held.append(low <= true <= high)
    return held


def _closures(known: Sequence[Judged]) -> list[Line]:
    told = [c.closure for c in known if c.truth["foretellable"] and c.closure is not None]
    missing = sum(c.truth["foretellable"] for c in known) - len(told)
    worst = [c.worst for c in told] + [inf] * missing
    removed = [c.removed for c in told]
    near = [c.closure_near_rest.worst for c in known
            if c.truth["foretellable"] and c.closure_near_rest is not None]  # fmt: skip
    if not worst:
        return [Line("closure", "no case", "")]
    quantiles = np.quantile(worst, [0.25, 0.5, 0.75, 0.95], method="nearest")
    spread = ", ".join(f"{q:.2f}" for q in quantiles)
    return [
        Line("closure, worst joint: median", f"{np.median(worst):.3f}  (quartiles, 95 %: {spread})",
             "<= 1.10"),
        rate("closure <= 1.2", [w <= 1.2 for w in worst], ">= 95 %"),
        Line("closure with rows near rest: median", f"{np.median(near):.3f}" if near else "-", ""),
        Line("reducible error removed: median", f"{np.nanmedian(removed):.2%}" if removed else "-",
             ""),
    ]  # fmt: skip


def _times(judged: Sequence[Judged]) -> Line:
    seconds = [c.seconds for c in judged] or [nan]
    value = f"median {np.median(seconds):.1f} s, largest {max(seconds):.1f} s"
    return Line("time of a diagnosis (2 recordings of about 75 s)", value, "<= 60 s for 5 min")


def resolution(pairs: Sequence[tuple[Judged, Judged]]) -> Line:
    """Return how often one requested motion settles what was ambiguous before it.

    Args:
        pairs: Each case before and after the motion that its diagnosis asked for.
    """
    return rate(
        "ambiguous pairs resolved by one requested motion",
        [
            _settled(after)
            for before, after in pairs
            if not all(map(_clear(before), before.effects))
        ],
        ">= 80 %",
    )


def _settled(case: Judged) -> bool:
    return all(map(_clear(case), case.effects))


def _clear(case: Judged) -> Callable[[dict[str, Any]], bool]:
    """Return whether a hidden effect is named with no rival that could be told apart from it."""

    def clear(effect: dict[str, Any]) -> bool:
        same = {effect["effect"], *effect["equivalent"]}
        return any(
            names(f, effect) and {f["effect"], *(f.get("equivalent") or ())} <= same
            for f in case.findings
        )

    return clear


def confusion(judged: Iterable[Judged]) -> list[tuple[str, list[tuple[str, int]]]]:
    """Return, for each hidden effect of single cases, what the main finding called it."""
    counts: dict[str, Counter[str]] = {}
    for case in judged:
        if len(case.effects) != 1:
            continue
        effect = case.effects[0]
        hidden = effect["law"] if effect["effect"] == UNKNOWN else effect["effect"]
        said = case.findings[0]["effect"] if case.findings else "nothing"
        counts.setdefault(hidden, Counter())[said] += 1
    return [(hidden, said.most_common()) for hidden, said in sorted(counts.items())]
