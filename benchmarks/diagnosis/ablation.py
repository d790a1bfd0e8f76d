"""Ablation of the diagnosis: what each part of it brings, and whether settings carry over.

One table has parts left out one by one, on real cases whose physics is known and on concealed ones.
Another has settings chosen without a source of the real cases, and what they reach on that source.
The folder of real cases holds their truth and their scorer, score_real.py.

    python benchmarks/diagnosis/diagnosis.py make --seeds 0:8 --kind any --seconds 8 --out out/short
    python benchmarks/diagnosis/ablation.py run REAL_CASES --concealed out/short
    python benchmarks/diagnosis/ablation.py tables

What is known of a version is kept, and a run that was ended goes on where it was.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from argparse import ArgumentParser
from collections import defaultdict
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from shutil import copyfile
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from diagnosis_judged import Judged
from fresh import folder

import limo_driver as limo
from estimators.regression.evidence import Posterior
from limo_driver.app.cli.predict import write
from limo_driver.app.library.learning import predict
from limo_driver.app.library.reading import read
from limo_driver.errors import LimoError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    Row = dict[str, Any]

WHOLE = "all of it"
DIAGNOSIS = "estimators.diagnosis"
FROM_TORQUE = f"{DIAGNOSIS}.from_torque"
FITTING = f"{FROM_TORQUE}.fitting"
SETTINGS = f"{DIAGNOSIS}.settings"


@dataclass(frozen=True)
class Change:
    """What a variant has instead: settings, and functions of modules."""

    settings: Mapping[str, object]  # by stage, group and name
    functions: Mapping[str, object]  # by module and name

    def make(self) -> None:
        """Change this process for good."""
        for name, value in self.settings.items():
            stage, group, setting = name.split(".")
            values = getattr(import_module(f"{SETTINGS}.{stage}"), group)
            if not hasattr(values, setting):
                raise SystemExit(f"{name}: no such setting")
            object.__setattr__(values, setting, value)  # they are frozen for all others
        for name, function in self.functions.items():
            module, _, own = name.rpartition(".")
            if not hasattr(import_module(module), own):
                raise SystemExit(f"{name}: no such function")
            setattr(import_module(module), own, function)


def _without(**settings: object) -> Change:
    return Change({name.replace("__", "."): value for name, value in settings.items()}, {})


PARTS: dict[str, Change] = {
    WHOLE: Change({}, {}),
    "short recordings: guards of 1 s": _without(residuals__HELD_OUT__guard_part=1.0),
    "bodies: as they are fitted, possible or not; no load in place of a link": Change(
        {},
        {
            f"{FITTING}.problem.with_possible_bodies": lambda *given: next(
                item.mean for item in given if isinstance(item, Posterior)
            ),
            f"{FITTING}.settling.loaded": lambda _problem, solution: solution,
        },
    ),
    "names: that need not surely help": Change(
        {},
        {
            f"{FITTING}.settling.surely_helps": lambda *_: True,
            f"{FITTING}.contribution.surely_helps": lambda *_: True,
            f"{FROM_TORQUE}.judgement.judgement.surely_helps": lambda *_: True,
        },
    ),
    "names: no simpler ones": Change(
        {}, {f"{FITTING}.settling.simplified": lambda _problem, solution: solution}
    ),
    "reach: three lines of a ripple": _without(fitting__RIPPLE__lines=3),
    "reach: no lateness of all of it": Change(
        {}, {f"{FROM_TORQUE}.events.with_torque_delay": lambda *_: None}
    ),
    "reach: no pushes": Change({}, {f"{FROM_TORQUE}.events.pushes": lambda *_: ()}),
    "reach: no jolts": Change({}, {f"{FROM_TORQUE}.events.jolts": lambda *_: ()}),
    "reach: no values beyond their tolerances": Change(
        {}, {f"{FROM_TORQUE}.events.suspects": lambda *_: set()}
    ),
}
CHOSEN: dict[str, Sequence[float]] = {  # values beside the one that stands
    "fitting.CONTRIBUTION.material": (0.35, 0.7),
    "judgement.JUDGEMENT.precise": (0.98, 0.995),
    "fitting.CANDIDATES.payload": (0.03, 0.3),
}
VALUES = {
    f"{name} = {value:g}": Change({name: value}, {})
    for name, values in CHOSEN.items()
    for value in values
}
VARIANTS = PARTS | VALUES


def run(variant: str, real: Path, concealed: Sequence[Path], out: Path) -> None:
    """Run a variant on all cases, in this process; what is known already is kept."""
    VARIANTS[variant].make()
    path = _file(out, variant)
    rows: list[Row] = json.loads(path.read_text()) if path.exists() else []
    known = {row["case"] for row in rows}
    rules = scorer(real)
    hidden = sorted(c.parents[1] for f in concealed for c in f.glob("*/hidden/truth.json"))
    for case in sorted(path.parent for path in real.glob("*/truth.json")):
        if case.name not in known:
            rows.append(_of_real(rules.run(case, out / path.stem, (), 0.0, False, False)))
            print(rows[-1], flush=True)
            path.write_text(json.dumps(rows, indent=1))
    for case in hidden if variant in PARTS else ():
        if f"{case.parent.name}/{case.name}" not in known:
            rows.append(_of_concealed(case))
            path.write_text(json.dumps(rows, indent=1))


def scorer(real: Path) -> Any:  # noqa: ANN401  # a module that lies with the data
    """Load the scorer of real cases, with commands that run in this process."""
    spec = importlib.util.spec_from_file_location("score_real", real / "score_real.py")
    if spec is None or spec.loader is None:
        raise SystemExit(f"{real}: no score_real.py")
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    scorer.call = _called
    return scorer


def _called(command: Sequence[str], _limit: float, log: Path) -> SimpleNamespace:
    """Run `diagnose` or `predict` with the options that the scorer gives them."""
    name, *given = command
    options = {a: Path(b) for a, b in pairwise(given) if a.startswith("--")}
    files = [Path(item) for item in given[: given.index("--sim")]]
    try:
        sim = limo.Simulation.load(options["--sim"])
        recordings = [read(path, sim.model, None) for path in files]
        if name == "diagnose":
            found = limo.diagnose(sim, recordings)
            found.verdict.save(options["--out"] / "verdict.json")
            found.simulation.save(options["--out"] / "sim.yaml")
        elif not _known(options["--out"]).exists():
            estimate = predict(sim, recordings[0], bandwidth=None, delay=None)
            columns = {"torque": estimate.torque}
            write(recordings[0], recordings[0].time, columns, options["--out"])
            if options["--out"].name.startswith("before"):
                _known(options["--out"]).parent.mkdir(exist_ok=True)
                copyfile(options["--out"], _known(options["--out"]))
        else:
            copyfile(_known(options["--out"]), options["--out"])
    except LimoError as error:
        log.write_text(str(error))
        return SimpleNamespace(returncode=2, stdout="", stderr=f"limo: {error}")
    return SimpleNamespace(returncode=0, stdout="", stderr="")


def _known(predicted: Path) -> Path:
    """Return where a prediction of the given simulation is kept, the same for all variants."""
    variant = predicted.parents[1]
    return variant.parent / "given" / f"{predicted.parent.name}_{predicted.name}"


def _of_real(result: Row) -> Row:
    said = "hit" in result
    return {
        "case": result["case"],
        "source": result["case"].split("_")[0],
        "wanted": result["wanted"],
        "named": result["hit"] if said else 0,
        "false": len(result["bad"]) + len(result["extra"]) if said else 0,
        "closed": result.get("closed"),
        "worse": len(result.get("worse", ())),
        "refused": not said,
    }


def _of_concealed(case: Path) -> Row:
    sim = limo.Simulation.load(case / "sim.yaml")
    recordings = [read(p, sim.model, None) for p in sorted(case.glob("recording_*.parquet"))]
    truth = json.loads((case / "hidden" / "truth.json").read_text())
    try:
        verdict = limo.diagnose(sim, recordings).verdict.as_values()
    except LimoError:
        verdict = None
    judged = Judged(case, truth, verdict, None, None, 0.0)
    wrong = [item for item in judged.misnamed if item["effect"] != "unknown"]
    right = judged.unknown_right if judged.kind == "unknown" else judged.exactly_right
    return {
        "case": f"{case.parent.name}/{case.name}",
        "right": right,
        "false": len(wrong),
        "refused": verdict is None,
    }


def tables(out: Path) -> str:
    """Return both tables as Markdown."""
    found = {
        variant: json.loads(_file(out, variant).read_text())
        for variant in VARIANTS
        if _file(out, variant).exists()
    }
    heads = ["left out", "real: named", "false", "closed", "joints worse", "refused"]
    if any("source" not in row for rows in found.values() for row in rows):
        heads += ["concealed: right", "false"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for variant in PARTS:
        if variant in found:
            real = [row for row in found[variant] if "source" in row]
            hidden = [row for row in found[variant] if "source" not in row]
            cells = (variant, *_counts(real), _sum(real, "worse"), _sum(real, "refused"))
            cells = (*cells, _of(hidden, "right"), _sum(hidden, "false"))[: len(heads)]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", *_without_a_source(found)])


def _without_a_source(found: Mapping[str, list[Row]]) -> list[str]:
    """Return the rows of the second table, in each the best variant on all other sources."""
    real: dict[str, dict[str, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for variant, rows in found.items():
        for row in rows if variant in {WHOLE, *VALUES} else ():
            if "source" in row:
                real[variant][row["source"]].append(row)
    lines = [
        "| source left out | best on the others | named there | false | closed | as they stand: "
        "named | false | closed |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for source in sorted(real[WHOLE]):
        merit = {
            variant: sum(_merit(row) for other, rows in of.items() if other != source
                         for row in rows)
            for variant, of in real.items()
        }  # fmt: skip
        best = max(merit, key=lambda variant: (merit[variant], variant == WHOLE))
        said = "as they stand" if best == WHOLE else best
        cells = (*_counts(real[best][source]), *_counts(real[WHOLE][source]))
        lines.append(f"| {source} | {said} | {' | '.join(cells)} |")
    return lines


def _merit(row: Row) -> int:
    return row["named"] + bool(row["closed"]) - row["false"]


def _counts(rows: Sequence[Row]) -> tuple[str, str, str]:
    named = f"{_sum(rows, 'named')} of {_sum(rows, 'wanted')}"
    judged = [row for row in rows if row["closed"] is not None]
    return named, _sum(rows, "false"), _of(judged, "closed")


def _sum(rows: Iterable[Row], key: str) -> str:
    return str(sum(row[key] for row in rows))


def _of(rows: Sequence[Row], key: str) -> str:
    return f"{_sum(rows, key)} of {len(rows)}"


def _file(out: Path, variant: str) -> Path:
    name = "".join(c if c.isalnum() or c in "._" else "-" for c in variant)
    return out / f"{name}.json"


def main() -> None:
    """Run every variant in a process of its own, or print the tables."""
    options = ArgumentParser(description="ablation of limo diagnose")
    options.add_argument("what", choices=("run", "tables"))
    options.add_argument("real", type=Path, nargs="?", help="folder of real cases, to run")
    options.add_argument("--concealed", type=Path, nargs="*", default=[], help="folders of cases")
    options.add_argument("--out", type=Path, default=folder("ablation"))
    options.add_argument("--variant", choices=VARIANTS, help="this one alone, in this process")
    given = options.parse_args()
    if given.what == "tables":
        print(tables(given.out))
        return
    if given.real is None:
        options.error("name the folder of real cases")
    given.out.mkdir(parents=True, exist_ok=True)
    if given.variant:
        run(given.variant, given.real, given.concealed, given.out)
        return
    for variant in VARIANTS:
        print(variant, flush=True)
        subprocess.run([sys.executable, *sys.argv, "--variant", variant], check=True)


if __name__ == "__main__":
    main()
