"""What a verdict on a concealed case got right: names, joints, classes, intervals, ambiguities.

A finding names a hidden effect if it, or an effect that either side calls indistinguishable from
it, is that effect, at its joints and no other. A class is one row of `FAMILIES`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnosis_closure import Closure, closure

if TYPE_CHECKING:
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
_BODIES = {"payload", "link_inertia", "gravity_direction", "external_contact"}


@dataclass(frozen=True)
class Judged:
    """One case: what was hidden, what was said, how well it predicts."""

    case: Path
    truth: dict[str, Any]
    verdict: dict[str, Any] | None  # None: the command failed
    closure: Closure | None
    closure_near_rest: Closure | None  # over all moving rows, those near rest included
    seconds: float

    @property
    def kind(self) -> str:
        """Return what was hidden: null, single, set, unknown or wrong_parameter."""
        return str(self.truth["kind"])

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
    def alarmed(self) -> bool:
        """Whether anything but agreement is said; a failed command is no agreement."""
        return (
            self.verdict is None or bool(self.findings) or self.verdict["verdict"] != "consistent"
        )

    @property
    def all_named(self) -> bool:
        """Whether everything hidden is named."""
        return all(any(names(f, e) for f in self.findings) for e in self.effects)

    @property
    def misnamed(self) -> list[dict[str, Any]]:
        """Return the findings that name nothing hidden, those that say `unknown` among them."""
        return [f for f in self.findings if not any(names(f, e) for e in self.effects)]

    @property
    def exactly_right(self) -> bool:
        """Whether everything hidden is named, and nothing else."""
        return self.verdict is not None and self.all_named and not self.misnamed

    @property
    def main_class_right(self) -> bool:
        """Whether the main finding is of the class of a single effect."""
        if not self.findings:
            return False
        main, effect = self.findings[0], self.effects[0]
        return same_effect(main, effect) or self._family(main) == _FAMILY[effect["effect"]]

    @property
    def main_named(self) -> bool:
        """Whether the main finding names a single effect."""
        return bool(self.findings) and names(self.findings[0], self.effects[0])

    @property
    def main_named_first(self) -> bool:
        """Whether it does so by its own name, not only by an equivalent that it lists."""
        bare = [f | {"equivalent": []} for f in self.findings[:1]]
        return bool(bare) and names(bare[0], self.effects[0])

    @property
    def called_wrong(self) -> bool:
        """Whether every value that is wrong in the file is said to be wrong, not missing.

        A finding that is the same in any motion says so by listing it: a load is a wrong last link.
        """
        return all(
            any(
                names(f, e) and (f.get("kind") == e["kind"] or f["effect"] in e["equivalent"])
                for f in self.findings
            )
            for e in self.effects
        )

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

    @property
    def unknown_joints(self) -> set[int]:
        """Return the joints at which something is said to be unexplained."""
        said = set((self.verdict or {}).get("unexplained", {}).get("joints") or [])
        return said | {j for f in self.findings if f["effect"] == UNKNOWN for j in f["joints"]}

    @property
    def unknown_located(self) -> bool:
        """Whether an effect outside the catalogue is seen at its joint, and maybe at others."""
        effect = self.effects[0]
        return self.all_named or bool(self.unknown_joints & set(effect["joints"]))

    @property
    def unknown_right(self) -> bool:
        """Whether it is seen at its joint and no other, and given no wrong name."""
        others = self.unknown_joints - set(self.effects[0]["joints"])
        wrong = [f for f in self.misnamed if f["effect"] != UNKNOWN]
        return self.unknown_located and not others and not wrong


def same_effect(finding: dict[str, Any], effect: dict[str, Any]) -> bool:
    """Whether a finding and a hidden effect go by one name, or cannot be told apart."""
    said, hidden = finding["effect"], effect["effect"]
    listed = finding.get("equivalent") or ()
    return said == hidden or said in effect["equivalent"] or hidden in listed


def names(finding: dict[str, Any], effect: dict[str, Any]) -> bool:
    """Whether a finding names a hidden effect, at its joints and no other."""
    said, true = set(finding["joints"]), set(effect["joints"])
    placed = bool(said) and said <= true
    whole = effect["effect"] in _BODIES and finding["effect"] in _BODIES - {"link_inertia"}
    return same_effect(finding, effect) and (placed or whole)


def judge(case: Path, out: str = "out") -> Judged:
    """Read one finished case."""
    truth = json.loads((case / "hidden" / "truth.json").read_text())
    result = json.loads((case / out / "result.json").read_text())
    path = case / out / "verdict.json"
    verdict = json.loads(path.read_text()) if result["status"] == 0 and path.exists() else None
    seconds = float(result["seconds"])
    return Judged(case, truth, verdict, closure(case, out), closure(case, out, 0.0), seconds)


def misses(finding: dict[str, Any], effect: dict[str, Any]) -> list[float]:
    """Return, for each number that both sides have, how far it is off in half-widths of its 95 %.

    The truth lists only parameters that mean the same in the plant's equation. A text among them
    says of which variant they are; a joint's number and the windows of pushes are no estimates.
    Entries of a list count singly.
    """
    if finding["effect"] != effect["effect"]:
        return []
    said, true = finding.get("parameters", {}), effect["parameters"]
    texts = {name: value for name, value in true.items() if isinstance(value, str)}
    if any(said.get(name, {}).get("value") != value for name, value in texts.items()):
        return []
    off: list[float] = []
    for name, value in true.items():
        interval = said.get(name, {}).get("ci95")
        if not interval or isinstance(value, (str, int)) or name == "windows":
            continue
        pairs, numbers = np.reshape(interval, (-1, 2)), np.atleast_1d(value)
        off += [
            float((2 * x - a - b) / max(b - a, 1e-12))
            for (a, b), x in zip(pairs, numbers, strict=False)
        ]
    return off


def coverage(finding: dict[str, Any], effect: dict[str, Any]) -> list[bool]:
    """Return whether the 95 % interval of each number holds the true one."""
    return [abs(miss) <= 1.0 for miss in misses(finding, effect)]


@dataclass(frozen=True)
class Ambiguity:
    """A hidden effect that was named beside others that the truth can be told apart from."""

    effect: dict[str, Any]
    asked: str | None  # the rival that the next motion is to rule out; None: no motion was offered

    def rivals(self, finding: dict[str, Any]) -> set[str]:
        """Return what a finding says besides the truth, or what is identical to it.

        A motion that is to tell the truth from another effect says that they are not identical.
        """
        said = {finding["effect"], *(finding.get("equivalent") or ())}
        return said - {self.effect["effect"], *self.effect["equivalent"]} | (said & {self.asked})

    def resolved(self, after: Judged, *, entirely: bool = False) -> bool:
        """Whether the effect is named after the motion, and the rival in question is out.

        Args:
            after: The diagnosis with the motion.
            entirely: Every rival has to be out.
        """
        left = [self.rivals(f) for f in after.findings if names(f, self.effect)]
        return any(not rivals if entirely else self.asked not in rivals for rivals in left)


def ambiguities(case: Judged) -> list[Ambiguity]:
    """Return the hidden effects that were named, but not alone."""
    found = [Ambiguity(effect, _asked(case, effect)) for effect in case.effects]
    named = [(a, [f for f in case.findings if names(f, a.effect)]) for a in found]
    return [a for a, findings in named if findings and all(map(a.rivals, findings))]


def _asked(case: Judged, effect: dict[str, Any]) -> str | None:
    wanted = (case.verdict or {}).get("next_motion") or {"separates": []}
    for pair in wanted["separates"]:
        for true in (effect["effect"], *effect["equivalent"]):
            if true in pair:
                return str(pair[1 - pair.index(true)])
    return None
