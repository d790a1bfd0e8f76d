"""Whether a diagnosis tells stated values that differ, and none that does not.

The arms are the concealed plants of `tests/concealed`, with torques and behind servos, which share
no code with limo. Three kinds of cases: one value of the file is wrong by 20 to 60 %, within its
tolerance or beyond; all are exactly as stated; all are off inside their tolerances. Bars: nine of
ten wrong values are reported with the right one; two of a hundred exact files have a value
reported, and as many of the others missing physics, or a value beyond; 92 % of intervals hold.

    python benchmarks/diagnosis/stated_values.py [--first 0] [--wrong 40] [--exact 40]
        [--inside 40] [--servos 20] [--seconds 30] [--joints 7]
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import yaml
from fresh import first_seed

import limo_driver as limo

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "concealed"))

import cases
import servo_cases
from variant import Variant

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.verdict import StatedValue, Verdict

SIZED = {  # effects that are put into the file with what every arm has, and their wrong value
    "spring_load": "stiffness",
    "payload": "mass",
    "armature": "inertia",
    "torque_gain": "gain",
    "torque_offset": "offset",
}
OF_ALL = ("tau_c", "f_v", "mass")
OF_SERVOS = ("kp", "delay", "tau_c", "f_v", "inertia")
SHARP = 0.8643  # width of a hyperbolic tangent over that of the plant's sign, of the same area
NEAR = 0.1  # of the true value, within which the one that fits is right, if no interval holds it
PLACED = {"tau_c": "coulomb_friction", "f_v": "viscous_friction", "inertia": "armature"}


class Exact:
    """Stands in for a random generator of which nothing is off."""

    def normal(self, size: int | None = None) -> Any:  # noqa: ANN401  # as numpy's
        """Return none."""
        return 0.0 if size is None else np.zeros(size)


@dataclass(frozen=True)
class Outcome:
    """What was reported in one case."""

    kind: str  # wrong, exact or inside
    seed: int
    hidden: tuple[str, int, float, float] | None  # name, joint (1-based), stated and true value
    verdict: Verdict
    truth: dict[tuple[str, str, int], float]  # by effect, name and joint

    @property
    def reported(self) -> list[StatedValue]:
        """Return the values that are reported."""
        return [item for item in self.verdict.values if item.reported]

    @property
    def right(self) -> bool:
        """Whether the wrong value is reported, and what fits is the true one.

        A mass that torques do not tell from those of links is in a family, which is right where the
        improved simulation errs by no more than noise.
        """
        fit = self.verdict.fit
        family = any(not item.effect for item in self.reported) and not fit.still_above
        mass = self.hidden is not None and self.hidden[0] == "mass"
        return any(map(self._is_hidden, self.reported)) or (mass and family)

    def _is_hidden(self, item: StatedValue) -> bool:
        if self.hidden is None:
            return False
        name, joint, _, true = self.hidden
        if name != item.name or (item.joints and joint not in item.joints):
            return False
        low, high = item.ci95 or (np.nan, np.nan)
        return low <= true <= high or abs(item.fitted - true) <= NEAR * abs(true)

    @property
    def others(self) -> list[StatedValue]:
        """Return the values that are reported of a file in which they are right."""
        return [item for item in self.reported if not self._is_hidden(item)]

    @property
    def alarmed(self) -> bool:
        """Whether physics is reported missing, or a value beyond its tolerance."""
        missing = [item for item in self.verdict.findings if item.kind == "missing"]
        return bool(missing) or any(item.beyond for item in self.reported)

    def covered(self) -> Iterator[bool]:
        """Yield whether the interval of each value holds the true one."""
        for item in self.verdict.values:
            true = self.truth.get((item.effect, item.name, *item.joints[:1]))
            if true is not None and item.ci95 is not None:
                yield item.ci95[0] <= true <= item.ci95[1]


def main() -> None:
    """Make, diagnose, and print each case and the figures with their bars."""
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument(
        "--first", type=int, default=first_seed(), help="seed; else by the version"
    )
    options.add_argument("--wrong", type=int, default=40)
    options.add_argument("--exact", type=int, default=40)
    options.add_argument("--inside", type=int, default=40)
    options.add_argument("--servos", type=int, default=20, help="wrong values of servos")
    options.add_argument("--nulls", type=int, default=10, help="servos of each other kind")
    options.add_argument("--seconds", type=float, default=30.0, help="of each recording of torques")
    options.add_argument("--joints", type=int, default=7, help="4, 6 or 7")
    asked = options.parse_args()
    variant = Variant(seconds=asked.seconds, joints=asked.joints)
    found: list[Outcome] = []
    for kind, count, own in (
        ("wrong", asked.wrong, asked.servos),
        ("exact", asked.exact, asked.nulls),
        ("inside", asked.inside, asked.nulls),
    ):
        for k in range(count + own):
            made = of_torques(kind, asked.first + k, k, variant) if k < count else None
            outcome = made or of_servos(kind, asked.first + k, k)
            found.append(outcome)
            print(line(outcome), flush=True)
    show(found)


def of_torques(kind: str, seed: int, k: int, variant: Variant) -> Outcome:
    """Diagnose an arm that tells torques."""
    names = [*OF_ALL, *SIZED]
    name = names[k % len(names)]
    random = np.random.default_rng([seed, 31])
    factor = float(random.choice((-1, 1)) * random.uniform(0.2, 0.6)) + 1.0
    case = _drawn(seed, name if kind == "wrong" and name in SIZED else None, variant)
    nominal = case.nominal if kind == "inside" else _exact(case)
    truth = {
        (PLACED[name], name, j + 1): float(values[j])
        for name, values in (
            ("tau_c", case.world.nominal.coulomb),
            ("f_v", case.world.nominal.viscous),
        )
        for j in range(len(values))
    }
    hidden = None
    if kind == "wrong":
        hidden = _made_wrong(case, nominal, name, factor, random, truth)
    case = replace(case, nominal=nominal)
    with tempfile.TemporaryDirectory() as folder:
        case.write(Path(folder))
        recordings = sorted(Path(folder).glob("recording_*.parquet"))
        verdict = limo.diagnose(Path(folder) / "sim.yaml", recordings).verdict
    return Outcome(kind, seed, hidden, verdict, {} if variant.joints < 7 else truth)


def _exact(case: cases.Case) -> dict[str, Any]:
    """Return the file of a case with nothing off: not even over which speeds a sign turns."""
    nominal = case.world.simulation_file(Exact())
    for entry in nominal["effects"]:
        if "v_eps" in entry:
            sharp = float(case.world.drive["sharpness"][entry["joint"] - 1])
            entry["v_eps"] = SHARP * sharp
    return nominal


def _drawn(seed: int, effect: str | None, variant: Variant) -> cases.Case:
    """Draw an arm that has one more effect, ten noise floors large, or none."""
    if effect is None:
        return cases.draw(seed, "null", variant)
    many = len(cases.KNOWN)
    turn = seed - seed % (3 * many) + 2 * many + seed % many  # that of the largest of three sizes
    for trial in range(20):
        try:
            case = cases.draw(turn + 3 * many * trial, "single", variant, effect)
        except cases.UnreachableError:
            continue
        own = case.hidden[0]
        values = own.draft.parameters(own.amplitude)
        if effect == "payload" and not _is_possible(case, values["mass"], values["com"]):
            continue
        if SIZED[effect] in values:  # of a law that limo has, too
            return case
    raise SystemExit(f"no arm has {effect} of ten noise floors near seed {seed}")


def _moments(case: cases.Case, mass: float, com: Sequence[float]) -> list[float]:
    """Return the inertia about its centre of a load that the arm carries, from what it adds."""
    arm, bare, link = case.world.arm, case.world.nominal.arm, len(case.world.arm.mass) - 1
    about = arm.inertia[link] - bare.inertia[link]
    for m, c in ((bare.mass[link], bare.com[link]), (mass, np.array(com))):
        r = c - arm.com[link]
        about = about - m * (r @ r * np.eye(3) - np.outer(r, r))
    return [float(about[i, j]) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]


def _is_possible(case: cases.Case, mass: float, com: Sequence[float]) -> bool:
    """Say whether a body has such moments: those of a drawn load need not."""
    xx, xy, xz, yy, yz, zz = _moments(case, mass, com)
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return bool(2.0 * moments.max() < moments.sum())


def _made_wrong(
    case: cases.Case,
    nominal: dict[str, Any],
    name: str,
    factor: float,
    random: np.random.Generator,
    truth: dict[tuple[str, str, int], float],
) -> tuple[str, int, float, float]:
    """Make one value of a file wrong; return name, joint, and the stated and the true value."""
    moving = [j + 1 for j in case.variant.moving]
    if name in SIZED:
        draft = case.hidden[0].draft
        entry = {"effect": draft.effect, **draft.parameters(case.hidden[0].amplitude)}
        joint = draft.joints[0]
        if draft.effect == "payload":
            entry["inertia"] = _moments(case, entry["mass"], entry["com"])
        else:
            entry["joint"] = joint
        key = SIZED[name]
        true = float(entry[key])
        entry[key] = true * factor
        nominal["effects"].append(entry)
        truth[draft.effect, key, joint] = true
        return key, joint, true * factor, true
    joint = int(random.choice(moving[1:]))
    if name == "mass":
        body = nominal["inertials"][f"link{joint}"]
        true, body["mass"] = body["mass"], body["mass"] * factor
        body["inertia"] = [x * factor for x in body["inertia"]]
        return "mass", joint, true * factor, true
    entry = next(
        e for e in nominal["effects"] if e["effect"] == PLACED[name] and e["joint"] == joint
    )
    true, entry[name] = entry[name], entry[name] * factor
    return name, joint, true * factor, true


def of_servos(kind: str, seed: int, k: int) -> Outcome:
    """Diagnose an arm behind servos, whose damping is where the file has it: in the joints."""
    case = servo_cases.make(seed, ())
    random = np.random.default_rng([seed, 32])
    fields = {
        "kp": "gain", "delay": "late", "tau_c": "dry", "inertia": "rotor", "torque_limit": "stall",
    }  # fmt: skip
    drives, effects = case.stated["drives"], case.stated["effects"]
    places: dict[tuple[str, int], tuple[dict[str, Any], float]] = {}
    for j, own in enumerate(case.servos, start=1):
        entries = [drives[j - 1], *(e for e in effects if e["joint"] == j)]
        entries[0]["kd"] = 0.0
        for entry in entries:
            for name in entry:
                if name in fields:
                    places[name, j] = entry, float(own[fields[name]])
                elif name == "f_v":
                    places[name, j] = entry, float(own["brake"] + own["wet"])
    for (name, _), (entry, true) in places.items():
        off = servo_cases.TOLERANCE * np.clip(random.normal(), -2, 2) * (kind == "inside")
        entry[name] = true * float(np.exp(off))
    hidden = None
    if kind == "wrong":
        name, joint = OF_SERVOS[k % len(OF_SERVOS)], int(random.choice((2, 3)))
        entry, true = places[name, joint]
        factor = float(random.choice((-1, 1)) * random.uniform(0.2, 0.6)) + 1.0
        factor = factor if name != "delay" else 1.0 + abs(factor - 1.0) * 4.0
        entry[name] = true * factor
        hidden = name, joint, true * factor, true
    effect = {"kp": "position_servo", "delay": "drive_delay"} | PLACED
    truth = {(effect[n], n, j): true for (n, j), (_, true) in places.items() if n in effect}
    with tempfile.TemporaryDirectory() as folder:
        sim, recordings = case.write(Path(folder))
        sim.write_text(yaml.safe_dump(case.stated))
        verdict = limo.diagnose(sim, recordings).verdict
    return Outcome(f"{kind} servos", seed, hidden, verdict, truth)


def line(outcome: Outcome) -> str:
    """Return a case in a line."""
    texts = [f"{x.name}@{','.join(map(str, x.joints))} {x.stated:.3g} to {x.fitted:.3g}"
            f"{' beyond' * x.beyond}" for x in outcome.reported]  # fmt: skip
    texts += [
        f"{x.effect}@{','.join(map(str, x.joints))} {x.kind}" for x in outcome.verdict.findings
    ]
    what = "nothing"
    if outcome.hidden is not None:
        name, joint, stated, true = outcome.hidden
        what = f"{name}@{joint} {stated:.3g} for {true:.3g} {'right' if outcome.right else 'WRONG'}"
    states = ", ".join(outcome.verdict.states)
    return f"{outcome.seed} {outcome.kind:13s} {what:38s} {states}: {'; '.join(texts) or '-'}"


def show(found: Sequence[Outcome]) -> None:
    """Print the figures with their bars."""
    for servos in ("", " servos"):
        wrong, exact, inside = (
            [x for x in found if x.kind == f"{kind}{servos}"]
            for kind in ("wrong", "exact", "inside")
        )
        held = [own for x in (*wrong, *exact, *inside) for own in x.covered()]
        agree = sum(x.verdict.states == ("agrees",) for x in exact)
        others = sum(len(x.others) for x in wrong)
        for what, hits, of, more in (
            ("wrong values reported with the right one", [x.right for x in wrong], 90,
             f"; {others} others reported"),
            ("exact files with a value reported", [bool(x.reported) for x in exact], 2,
             f"; {agree} agree"),
            ("files off inside, reported missing physics or beyond", [x.alarmed for x in inside], 2,
             ""),
            ("intervals that hold the true value", held, 92, ""),
        ):  # fmt: skip
            print(f"{what}{servos}: {sum(hits)} of {len(hits)} (bar {of} %){more}")


if __name__ == "__main__":
    main()
