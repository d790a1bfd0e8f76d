"""Diagnosis on concealed cases: make them, run the commands on them, score the verdicts.

`python benchmarks/diagnosis/diagnosis.py` does all three on seeds that nothing was tuned to
(`fresh.py`) and prints each figure beside its bar; ended, it goes on where it was. The plant that
makes the cases lives in tests/concealed and shares no code with the catalogue of effects.

    python benchmarks/diagnosis/diagnosis.py --quick --library
    python benchmarks/diagnosis/diagnosis.py make --seeds 0:75 --kind single --out out/concealed
    python benchmarks/diagnosis/diagnosis.py make --seeds 0:8 --seconds 10 --out out/short
    python benchmarks/diagnosis/diagnosis.py make --seeds 25:35 --only backlash --out out/play
    python benchmarks/diagnosis/diagnosis.py run out/concealed --jobs 2
    python benchmarks/diagnosis/diagnosis.py run out/short --library   # no report: half the time
    python benchmarks/diagnosis/diagnosis.py follow out/concealed --jobs 2
    python benchmarks/diagnosis/diagnosis.py score out/concealed
    python benchmarks/diagnosis/diagnosis.py time
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from shutil import rmtree
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer
import yaml
from diagnosis_judged import Judged, judge
from diagnosis_library import called, write_result
from diagnosis_oracle import ORACLE, write_oracle
from diagnosis_score import Line, confusion, resolution, score
from fresh import first_seed
from fresh import folder as kept
from rich.console import Console
from rich.progress import track
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Callable

CONCEALED = Path(__file__).parents[2] / "tests" / "concealed"
LIMO = Path(sys.executable).with_name("limo")
FULL = {"null": 200, "single": 225, "set": 100, "unknown": 50, "wrong_parameter": 50}
QUICK = {"null": 12, "single": 30, "set": 12, "unknown": 8, "wrong_parameter": 8}
ASKED, NEXT = "next_motion.parquet", "next.parquet"  # the motion asked for, the answer to it
TIME_LIMIT = 600.0  # [s] of one command

app = typer.Typer(add_completion=False, rich_markup_mode=None)
Out = Annotated[Path, typer.Option(help="Folder of the cases.")]
Jobs = Annotated[int, typer.Option(help="Cases at a time.")]


@app.callback(invoke_without_command=True)
def everything(
    context: typer.Context,
    seeds: Annotated[int | None, typer.Option(help="First seed; else by the version.")] = None,
    quick: Annotated[bool, typer.Option(help="A ninth of the cases.")] = False,
    library: Annotated[bool, typer.Option(help="Call the library: no next motion.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder; else by the version.")] = None,
    jobs: Jobs = 2,
) -> None:
    """Make fresh cases, run the commands on them and score the verdicts."""
    if context.invoked_subcommand:
        return
    first, out = seeds or first_seed(), out or kept("concealed")
    folders: list[Path] = []
    for kind, count in (QUICK if quick else FULL).items():
        folders.append(out / f"{kind}_{first}")
        make(f"{first}:{first + count}", kind, folders[-1], jobs)
    for folder in folders:
        run(folder, jobs, library=library)
        if not library:
            follow(folder, jobs)
    print_score(folders)


@app.command()
def make(
    seeds: Annotated[str, typer.Option(help="first:last, the last left out.")],
    kind: Annotated[
        str, typer.Option(help="null, single, set, unknown, wrong_parameter or any.")
    ] = "any",
    out: Out = Path("out/concealed"),
    jobs: Jobs = 1,
    seconds: Annotated[float, typer.Option(help="Of each recording; 0: over a minute.")] = 0.0,
    full_scale: Annotated[float, typer.Option(help="Torque of the strongest drive, N m.")] = 320.0,
    joints: Annotated[int, typer.Option(help="4, 6 or 7.")] = 7,
    only: Annotated[str, typer.Option(help="Effect of every single case.")] = "",
) -> None:
    """Make cases; those that exist are kept."""
    variant = {"seconds": seconds, "full_scale": full_scale, "joints": joints}
    kind = "single" if only else kind
    first, last = (int(x) for x in seeds.split(":"))
    wanted = [s for s in range(first, last) if not _truth(out, s).exists()]
    outcomes = _each(
        partial(_make_one, kind, out, variant, only or None),
        wanted,
        jobs,
        f"making {kind}",
        processes=True,
    )
    given_up = [text for text in outcomes if text]
    for text in given_up:
        print(text)
    print(f"{kind}, seeds {seeds}: {last - first - len(given_up)} cases, {len(given_up)} seeds "
          f"out of reach; in {out}")  # fmt: skip


@app.command()
def run(
    folder: Annotated[Path, typer.Argument(help="Folder of the cases.")],
    jobs: Jobs = 2,
    name: Annotated[str, typer.Option(help="Folder inside each case for the results.")] = "out",
    limit: Annotated[float, typer.Option(help="Time limit of one command, s.")] = TIME_LIMIT,
    library: Annotated[
        bool, typer.Option(help="Call the library: no next motion, replay and report.")
    ] = False,
) -> None:
    """Run `limo diagnose` and `limo predict` on each case; finished cases are skipped."""
    cases = [case for case in _cases(folder) if not _finished(case / name)]
    work = partial(called, name) if library else partial(_run_one, name, limit)
    _each(work, cases, jobs, f"diagnosing {folder.name}", processes=library)


@app.command()
def oracle(
    folder: Annotated[Path, typer.Argument(help="Folder of the cases.")],
    jobs: Jobs = 1,
) -> None:
    """Fit what was hidden to the same rows, as if it were known; `score` shows its closure."""
    cases = [case for case in _cases(folder) if not (case / ORACLE).exists()]
    _each(write_oracle, cases, jobs, f"oracle {folder.name}", processes=True)


@app.command()
def follow(
    folder: Annotated[Path, typer.Argument(help="Folder of the cases, diagnosed.")],
    jobs: Jobs = 2,
    name: Annotated[str, typer.Option(help="Folder inside each case with the results.")] = "out",
    limit: Annotated[float, typer.Option(help="Time limit of one command, s.")] = TIME_LIMIT,
) -> None:
    """Record the next motion wherever one was asked for, and diagnose again with it."""
    asked = [
        case for case in _cases(folder)
        if (case / name / ASKED).exists() and not _finished(case / f"{name}_next")
    ]  # fmt: skip
    _each(partial(_record_next, name), asked, jobs, "recording", processes=True)
    again = [case for case in asked if (case / f"{name}_next" / NEXT).exists()]
    _each(partial(_run_next, name, limit), again, jobs, f"again {folder.name}")


@app.command("score")
def print_score(
    folders: Annotated[list[Path], typer.Argument(help="Folders of cases.")],
    name: Annotated[str, typer.Option(help="Folder inside each case with the results.")] = "out",
) -> None:
    """Print every line of the bar, and what each hidden effect was called."""
    finished = [c for folder in folders for c in _cases(folder)
                if (c / name / "result.json").exists()]  # fmt: skip
    judged = [judge(case, name) for case in finished]
    console = Console(width=140, highlight=False)
    table = Table("what", "measured", "bar", title=f"{len(judged)} concealed cases")
    for line in [*score(judged), *_resolution(judged, name)]:
        table.add_row(line.what, line.value, line.bar)
    console.print(table)
    names = Table("hidden", "named (main finding)", title="single effects, unknown, wrong values")
    for hidden, said in confusion(judged):
        names.add_row(hidden, ", ".join(f"{effect} {count}" for effect, count in said))
    console.print(names, _wrong(judged))


@app.command("time")
def print_time(
    seed: Annotated[int, typer.Option(help="Seed of a single effect.")] = 1_000_000,
    out: Out = Path("out/concealed"),
) -> None:
    """Time the diagnosis of one recording of five minutes at 250 Hz; nothing else should run."""
    sys.path.insert(0, str(CONCEALED))
    import arm
    import cases
    import motions
    import numpy as np

    drawn = cases.draw(seed, "single")
    case = replace(drawn, instruments=replace(drawn.instruments, rate=250.0))
    random = np.random.default_rng(seed)
    kinds = ["limopa", "creep", "fourier", "points", "nested"]
    motion, _ = motions.recording(kinds, 300.0, arm.load()[1], random)
    folder = out / f"time_{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    case.answer(motion, folder / "recording_1.parquet")
    (folder / "sim.yaml").write_text(yaml.safe_dump(case.nominal, sort_keys=False))
    os.environ.setdefault("OMP_NUM_THREADS", str(len(os.sched_getaffinity(0))))
    status, seconds, message = _diagnose(folder, folder / "out", TIME_LIMIT)
    used = getrusage(RUSAGE_CHILDREN)
    print(f"{len(motion) / 1000:.0f} s of 7 joints at 250 Hz: {seconds:.1f} s (bar 60 s)")
    print(f"{used.ru_utime + used.ru_stime:.1f} s of processor; exit status {status} {message}")


def _resolution(judged: list[Judged], name: str) -> list[Line]:
    """Pair each case with its diagnosis after the motion that it asked for."""
    pairs: list[tuple[Judged, Judged | None]] = []
    waiting = 0
    for before in judged:
        if not (before.case / name / ASKED).exists():
            pairs.append((before, None))
        elif (before.case / f"{name}_next" / "result.json").exists():
            pairs.append((before, judge(before.case, f"{name}_next")))
        else:
            waiting += 1
    return resolution(pairs, waiting)


def _wrong(judged: list[Judged]) -> Table:
    table = Table("case", "hidden", "said", "closure", title="cases that are not exactly right")
    for case in judged:
        if case.exactly_right:
            continue
        hidden = [f"{e['effect']} {e['law']} {e['joints']} {e['size']:.1f}x" for e in case.effects]
        said = [f"{f['effect']} {f['joints']} {f['confidence']:.2f}" for f in case.findings]
        closure = f"{case.closure.worst:.2f}" if case.closure else "-"
        where = f"{case.case.parent.name}/{case.case.name}"
        table.add_row(where, "; ".join(hidden) or "nothing", "; ".join(said) or "nothing", closure)
    return table


def _finished(out: Path) -> bool:
    """Whether a case has been diagnosed; one whose command failed is tried again."""
    path = out / "result.json"
    return path.exists() and json.loads(path.read_text())["status"] == 0


def _truth(out: Path, seed: int) -> Path:
    return out / f"{seed:07d}" / "hidden" / "truth.json"


def _cases(folder: Path) -> list[Path]:
    return sorted(path.parent.parent for path in folder.glob("*/hidden/truth.json"))


def _each(
    work: Callable[..., object],
    items: list,
    jobs: int,
    what: str,
    *,
    processes: bool = False,
) -> list:
    """Work on items, several at a time, behind a progress bar on stderr."""
    console = Console(stderr=True)
    pool = ProcessPoolExecutor(jobs) if processes else ThreadPoolExecutor(jobs)
    with pool:
        done = pool.map(work, items)
        return list(track(done, what, total=len(items), console=console))


def _make_one(kind: str, out: Path, variant: dict[str, float], only: str | None, seed: int) -> str:
    """Write a case; return why there is none, or nothing."""
    sys.path.insert(0, str(CONCEALED))
    import cases  # compiled once in each process

    drawn_as = None if kind == "any" else kind
    try:
        drawn = cases.draw(seed, drawn_as, cases.Variant(**variant), only)
        drawn.write(_truth(out, seed).parents[1])
    except cases.UnreachableError as error:
        return str(error)
    return ""


def _record_next(name: str, case: Path) -> None:
    """Record the motion that a diagnosis asked for; where that fails, the result says why."""
    sys.path.insert(0, str(CONCEALED))
    import cases

    from limo_driver.errors import LimoError
    from limo_driver.trajectory import Trajectory

    out = case / f"{name}_next"
    out.mkdir(exist_ok=True)
    truth = json.loads((case / "hidden" / "truth.json").read_text())
    try:
        trajectory = Trajectory.load(case / name / ASKED)
    except LimoError as error:
        write_result(out, (2, 0.0, f"{ASKED}: {error}"))
        return
    variant = cases.Variant(**truth.get("variant", {}))
    drawn = cases.draw(truth["seed"], truth["drawn_as"], variant, truth.get("only"))
    if not drawn.is_of(truth):
        raise SystemExit(f"{case}: made by other code, and seed {truth['seed']} gives another arm")
    drawn.answer(trajectory.resample(1e-3).position, out / NEXT)


def _run_next(name: str, limit: float, case: Path) -> None:
    """Diagnose again, with the motion that was asked for."""
    out = case / f"{name}_next"
    write_result(out, _diagnose(case, out, limit, out / NEXT))


def _run_one(name: str, limit: float, case: Path) -> None:
    """Diagnose, and let both simulations predict the held-out motions."""
    out = case / name
    out.mkdir(exist_ok=True)
    rmtree(case / f"{name}_next", ignore_errors=True)  # it answers an earlier diagnosis
    status, seconds, message = _diagnose(case, out, limit)
    for label, sim in (("before", case / "sim.yaml"), ("after", out / "sim.yaml")):
        for k in (1, 2) if sim.exists() else ():
            target = out / f"{label}_{k}.parquet"
            held_out = case / f"held_out_{k}.parquet"
            failed, why = _limo(limit, "predict", held_out, "--sim", sim, "--out", target)
            message += f"\npredict {label} {k}: {why}" if failed else ""
    write_result(out, (status, seconds, message))


def _diagnose(case: Path, out: Path, limit: float, *more: Path) -> tuple[int, float, str]:
    """Return status, seconds and complaints."""
    recordings = [*sorted(case.glob("recording_*.parquet")), *more]
    begin = perf_counter()
    status, message = _limo(
        limit, "diagnose", *recordings, "--sim", case / "sim.yaml", "--out", out, "--json"
    )  # fmt: skip
    return status, perf_counter() - begin, message


def _limo(limit: float, *arguments: object) -> tuple[int, str]:
    """Run one command; return its status and the end of what it complained about."""
    environment = os.environ | {"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}
    try:
        done = subprocess.run(
            [str(LIMO), *map(str, arguments)], capture_output=True, text=True, timeout=limit,
            env=environment, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 124, f"ran past {limit:g} s"
    return done.returncode, done.stderr[-2000:] if done.returncode else ""


if __name__ == "__main__":
    app()
