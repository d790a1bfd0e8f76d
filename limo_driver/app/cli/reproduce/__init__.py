"""`limo reproduce`: tables of published work, computed again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.cli import INTERRUPTED
from limo_driver.app.console.command_line import describe_options
from limo_driver.app.console.terminal import Machines, OnOption, progress, terminal
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import only_writer, require_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from estimators.studies.table1_results import Protocol, Table, Trial, TrialStore
    from estimators.studies.table1_trials import TrialRunner

OUT, QUICK_OUT = Path("out/table1"), Path("out/table1_quick")
DATA, QUICK_DATA = "data", "data_quick"  # simulated, in OUT; the quick one is far less motion
FILES = ("report.html", "table1.json")
FAILED = 1
command = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@describe_options
def table1(
    *,
    data: Path | None = None,
    out: Annotated[
        Path | None,
        typer.Option(help=f"Folder for trials and table; {OUT}, or {QUICK_OUT} with --quick."),
    ] = None,
    quick: bool = False,
    runs: int | None = None,
    device: str = "auto",
    jobs: int | None = None,
    epochs: int | None = None,
    batch: int | None = None,
    on: OnOption = Machines.processes,
) -> None:
    r"""Compute Table I of Çallar and Böttger 2022 again, beside the paper's figures.

    Rigid body, perceptrons, LSTMs and Transformer, standalone and hybrid, with and without the
    rotational history, and a GRU and an LRU, which the paper lacks: errors on training, test and
    validation motion for each joint, mean and spread over runs. The paper's random split of
    sub-sequences stands beside an honest one, which tests on scaffolds that were never trained on.

    Started again, the command goes on where it was stopped or killed, in the middle of a trial too.

    Args:
        data: Folder of excitation, limo and validation recordings and data.json; OUT/data if not
            given, OUT/data_quick with --quick, which is simulated if it is not there.
        quick: Minutes instead of days: little motion, few epochs, one run.
        runs: Trainings of each row, from other seeds; 10.
        device: Where networks are trained: auto (a GPU if there is one), cpu, cuda.
        jobs: Trials side by side; one for each physical core, or one on a GPU.
        epochs: Passes over the motion; 100.
        batch: Sub-sequences of one step of the optimiser; 50. Less on short recordings, of which 50
            would leave a step or two in an epoch.

    Examples:
        limo reproduce table1 --quick
        limo reproduce table1 --data recordings/ --runs 3 --out out/table1
        limo reproduce table1 --data half_a_minute/ --batch 1 \
            --out out/half_a_minute
        limo reproduce table1 --on ray
    """
    from dataclasses import replace

    from estimators.studies.table1_results import Protocol

    notes = terminal(stderr=True, soft_wrap=True)
    protocol = Protocol(runs=1, epochs=2, batch=5) if quick else Protocol()
    given = {"runs": runs, "epochs": epochs, "batch": batch}
    protocol = replace(protocol, **{name: n for name, n in given.items() if n is not None})
    processes = _processes(jobs, device, on)
    out = out or (QUICK_OUT if quick else OUT)
    require_folder(out, "the table")
    with only_writer(out):
        folder = data or out / (QUICK_DATA if quick else DATA)
        if data is None and not folder.exists():
            _make_data(folder, quick=quick, notes=notes)
        status = _compute(folder, out, protocol, (device, processes, on.value), notes)
    if status:
        raise typer.Exit(status)


def _compute(
    folder: Path, out: Path, protocol: Protocol, where: tuple[str, int | None, str], notes: Console
) -> int:
    """Run the trials that are not finished yet, write the table, and return the exit status."""
    from estimators.studies.table1_data import TableData, physics_digest, rigid_body
    from estimators.studies.table1_page import PAGE, table_page, write
    from estimators.studies.table1_results import Table, TrialStore
    from estimators.studies.table1_trials import TrialRunner
    from limo_driver.physics import Simulation

    read = TableData.load(folder)
    for name in ("trials", "prepared"):
        require_folder(out / name, "the table")
    with notes.status("identifying the rigid body"):
        simulation = rigid_body(read, out / "prepared")
    store = TrialStore(out / "trials", physics_digest(simulation))
    device, workers, on = where

    def update() -> Table:
        table = Table.gather(read, protocol, store)
        write(table, out)
        return table

    unfinished = out / "unfinished" if on == Machines.processes.value else None
    runner = TrialRunner(read, Simulation.load(simulation), device, unfinished)
    trials = protocol.trials(read.digests)
    status = _run(runner, store, trials, (workers, on), update, notes)
    table = update()
    table_page(table).save(out / PAGE)
    _print(table, out)
    return status


def _processes(jobs: int | None, device: str, on: Machines) -> int | None:
    """Return how many trials run side by side; one where they share a GPU.

    Those of a cluster are as many as it has cores.
    """
    from estimators.hybrid.training.fit import find_device
    from estimators.studies.table1_trials import physical_cores

    gpu = find_device(device).type == "cuda"
    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs is {jobs}, expected 1 or more")
    if on == Machines.ray:
        if gpu and device == "cuda":
            raise ConfigError("--device is cuda, but on Ray each trial has one core; expected auto")
        return jobs
    return jobs or (1 if gpu else physical_cores())


def _make_data(folder: Path, *, quick: bool, notes: Console) -> None:
    """Make a data folder behind a progress bar."""
    from rich.progress import BarColumn, TimeElapsedColumn

    from limo_driver.app.cli.reproduce.simulated_data import FULL, QUICK, make

    notes.print(f"{folder} is not there: making it with the simulated arm")
    with progress("{task.description}", BarColumn(), TimeElapsedColumn(), console=notes) as bar:
        task = bar.add_task("making data", total=1.0)

        def tell(what: str, share: float) -> None:
            bar.update(task, description=what, completed=share)

        made = make(folder, QUICK if quick else FULL, tell)
    if not made:
        raise typer.Exit(INTERRUPTED)


def _run(
    runner: TrialRunner,
    store: TrialStore,
    trials: Sequence[Trial],
    where: tuple[int | None, str],
    update: Callable[[], object],
    notes: Console,
) -> int:
    """Run what is not finished yet, update the files after each, and return the exit status."""
    from estimators.studies.table1_trials import Failed
    from limo_driver.app.cli.reproduce.simulated_data import TrialProgress
    from limo_driver.app.library.demonstrating import run_trials

    finished = {trial.file_name: store.load(trial) for trial in trials}
    waiting = [trial for trial in trials if finished[trial.file_name] is None]
    if not waiting:
        return 0
    failed: list[Failed] = []
    with TrialProgress(
        notes, trials, [r for r in finished.values() if r is not None], where[0]
    ) as watch:
        try:
            for ended in run_trials(runner, store, waiting, where, watch.advanced):
                if isinstance(ended, Failed):
                    watch.failed(ended.trial, ended.reason)
                    failed.append(ended)
                else:
                    watch.finished(ended.trial, ended.seconds)
                    update()
        except KeyboardInterrupt:
            notes.print("stopped; finished trials are kept, the same command goes on with the rest")
            return INTERRUPTED
    return FAILED if failed else 0


def _print(table: Table, out: Path) -> None:
    """Print the joint averages; all joints are in the files."""
    from rich.table import Table as Grid

    from estimators.studies.table1_data import ALL_ROWS, PARTS
    from estimators.studies.table1_page import cell, done
    from estimators.studies.table1_results import SPLIT_NAMES, SPLITS

    console = terminal()
    console.print(table.headline())
    for split in SPLITS:
        grid = Grid(
            "architecture", "runs", *PARTS,
            title=f"Table I, joint average: {SPLIT_NAMES[split]}",
            title_justify="left",
        )  # fmt: skip
        for row in ALL_ROWS:
            figures = [table.figures(row, part, split) for part in PARTS]
            grid.add_row(row.name, done(figures[0]), *(cell(f, -1) for f in figures))
        console.print(grid)
    console.print(table.scored)
    console.print(f"wrote {out}: {', '.join(FILES)}", soft_wrap=True)


@command.callback()
def reproduce() -> None:
    """Compute tables of published work again, on data of your own.

    Example:
        limo reproduce table1 --quick
    """


@describe_options
def bench(folder: Path, *, as_json: bool = False) -> None:
    """Compute benchmarks of others with limo, and show their figures.

    The files are the authors' own, under their names: DATA_EMPS.mat and DATA_EMPS_PULSES.mat of the
    EMPS; case1_high.csv to case4_slow.csv of NNFM. What is there is computed.

    Args:
        folder: With the files, in it or in folders below.
        as_json: Print the figures as JSON.

    Examples:
        limo reproduce bench benchmarks_of_others/
    """
    from dataclasses import asdict

    from rich.table import Table as Grid

    from estimators.studies.bench import bench as computed

    if not folder.is_dir():
        raise ConfigError("no such folder", path=folder)
    notes = terminal(stderr=True, soft_wrap=True)
    rows = computed(folder, notes.print)
    if as_json:
        terminal().print_json(data=[asdict(row) for row in rows])
        return
    grid = Grid("benchmark", "measure", "who", "figure", "from", box=None)
    for row in rows:
        grid.add_row(row.benchmark, row.measure, row.who, f"{row.figure:.3g}", row.source)
    terminal().print(grid)


command.command(name="table1")(table1)
command.command(name="bench")(bench)
