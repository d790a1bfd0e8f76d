"""Diagnosis of arms whose friction nobody knows: one log and a bare description, as strangers have.

Each case is an arm of tests/concealed, which shares no code with the catalogue of effects. All its
joints rub, each as it likes; its bodies are off the description by 2 %; and something unusual is in
it, or nothing. The command gets one recording and the name of the description:

    limo diagnose recording.parquet --robot iiwa14 --out OUT

A name is right if it is the unusual thing at its joint, or something listed as equivalent to it.
Every other name is false, and so is friction that is ordinary among the findings.

    python benchmarks/diagnosis/unknown_friction.py              # on fresh seeds (fresh.py)
    python benchmarks/diagnosis/unknown_friction.py --seeds 20000:20032
    python benchmarks/diagnosis/unknown_friction.py --only payload_and_drag --seconds 20
"""

from __future__ import annotations

import json
import subprocess
import sys
from argparse import ArgumentParser
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from fresh import first_seed, folder

from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from strangers import Unusual

CONCEALED = Path(__file__).parents[2] / "tests" / "concealed"
LIMO = Path(sys.executable).with_name("limo")
SURE = 0.5  # confidence from which a name is one


@dataclass(frozen=True)
class Case:
    """What was hidden, and what was said of it."""

    kind: str
    seed: int
    unusual: tuple[Unusual, ...]
    verdict: dict[str, Any] | None  # None: the command failed
    seconds: float

    @property
    def said(self) -> list[dict[str, Any]]:
        """Return the findings that are sure enough to be names."""
        found = self.verdict["findings"] if self.verdict else []
        return [f for f in found if f["effect"] != "unknown" and f["confidence"] >= SURE]

    @property
    def false(self) -> list[str]:
        """Return the names that are of nothing hidden."""
        return [
            f"{finding['effect']} {finding['joints']}"
            for finding in self.said
            if not any(_is(finding, item) for item in self.unusual)
        ]

    @property
    def right(self) -> bool:
        """Say whether all that is hidden is named, and nothing else."""
        return bool(self.verdict) and not self.false and all(map(self.named, self.unusual))

    @property
    def mass_error(self) -> float:
        """Return the relative error of the payload's mass; NaN where none was hidden and found."""
        true = [item.mass for item in self.unusual if item.effect == "payload"]
        found = [f["parameters"]["mass"]["value"] for f in self.said if f["effect"] == "payload"]
        return found[0] / true[0] - 1.0 if true and found else float("nan")

    def named(self, item: Unusual) -> bool:
        """Say whether a finding names an unusual thing."""
        return any(_is(finding, item) for finding in self.said)

    def line(self) -> str:
        """Return what was hidden and what was said."""
        hidden = ", ".join(self._hidden(item) for item in self.unusual) or "nothing"
        if self.verdict is None:
            return f"{self.kind:17} {self.seed}  {hidden}  FAILED"
        unknown = [f["joints"] for f in self.verdict["findings"] if f["effect"] == "unknown"]
        mass = f"  mass {100 * self.mass_error:+.0f} %" if np.isfinite(self.mass_error) else ""
        return (
            f"{self.kind:17} {self.seed}  {hidden}{mass}  false: {', '.join(self.false) or '-'}  "
            f"unknown: {unknown or '-'}  identified: {len(self.verdict['identified'])}  "
            f"{self.seconds:.0f} s"
        )

    def _hidden(self, item: Unusual) -> str:
        size = f" {item.mass:.2f} kg" if np.isfinite(item.mass) else ""
        size = f" {item.size:.0f} floors" if np.isfinite(item.size) else size
        return f"{item.effect} {item.joint}{size}{'' if self.named(item) else ' MISSED'}"


def _is(finding: dict[str, Any], item: Unusual) -> bool:
    names = {finding["effect"], *finding["equivalent"]}
    return bool(names & {item.effect, *item.equivalent}) and item.joint in finding["joints"]


def run(kind: str, seed: int, seconds: float, out: Path, name: str) -> Case:
    """Record an arm, diagnose it as a stranger would, and read the verdict."""
    import strangers

    folder = out / f"{kind}_{seed}_{seconds:g}"
    drawn = strangers.draw(kind, seed, seconds)
    recording, verdict = folder / "recording.parquet", folder / name / "verdict.json"
    if not recording.exists():
        folder.mkdir(parents=True, exist_ok=True)
        recorded = drawn.record()
        Recording.from_arrays(recorded.time, recorded.position, recorded.torque).save(recording)
    start = perf_counter()
    if not verdict.exists():
        command = [LIMO, "diagnose", recording, "--robot", "iiwa14", "--out", verdict.parent]
        subprocess.run(command, capture_output=True, check=False)
    said = json.loads(verdict.read_text(encoding="utf-8")) if verdict.exists() else None
    return Case(kind, seed, drawn.unusual, said, perf_counter() - start)


def report(cases: Sequence[Case]) -> str:
    """Return the measured figures beside their bars."""
    unusual = [(case, item) for case in cases for item in case.unusual]
    masses = [(c, item) for c, item in unusual if item.effect == "payload"]
    nulls = [case for case in cases if not case.unusual]
    rows = [
        ("exactly right", [case.right for case in cases], ">= 85 %"),
        ("unusual things named", [case.named(item) for case, item in unusual], ">= 90 %"),
        ("payload's mass within 10 %", [abs(c.mass_error) < 0.1 for c, _ in masses], "all"),
        ("cases with a false name", [bool(case.false) for case in cases], "0"),
        ("nulls with a name", [bool(case.said) for case in nulls], "0"),
        ("commands that failed", [case.verdict is None for case in cases], "0"),
    ]
    return "\n".join(
        f"{what:28} {sum(true):3} of {len(true):3}   bar {bar}" for what, true, bar in rows
    )


def main() -> None:
    """Run the cases of a range of seeds, kind after kind."""
    sys.path.insert(0, str(CONCEALED))
    from strangers import KINDS

    options = ArgumentParser(description="limo diagnose with a bare description and one log")
    fresh = f"{first_seed()}:{first_seed() + 16}"
    options.add_argument("--seeds", default=fresh, help="first:last, the last left out")
    options.add_argument("--only", nargs="*", default=KINDS, choices=KINDS)
    options.add_argument("--seconds", type=float, default=60.0, help="length of the log")
    options.add_argument("--out", type=Path, default=folder("unknown_friction"))
    options.add_argument("--name", default="out", help="folder of the results inside each case")
    given = options.parse_args()
    first, last = map(int, given.seeds.split(":"))
    print(f"seeds {given.seeds}")
    cases = []
    for k, seed in enumerate(range(first, last)):
        kind = given.only[k % len(given.only)]
        cases.append(run(kind, seed, given.seconds, given.out, given.name))
        print(cases[-1].line(), flush=True)
    print(report(cases))


if __name__ == "__main__":
    main()
