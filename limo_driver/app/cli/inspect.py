"""`limo inspect`: what a log of any format holds, and the mapping that reads it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.command_line import ROBOTS, describe_options, in_options
from limo_driver.app.console.terminal import terminal
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.quoting import in_shell
from limo_driver.runtime.outputs import require_file, require_page, whole

if TYPE_CHECKING:
    from limo_driver.logs.readers.inspection import Inspection, Settled
    from limo_driver.logs.readers.proposals.proposal import NothingProposedError
    from limo_driver.model import RobotModel

_MAPPING = Path("mapping.yaml")


@describe_options
def command(
    log: Path,
    *,
    robot: Annotated[
        str | None,
        typer.Option(help=f"The arm: {ROBOTS}. Without one, --page shows the columns as logged."),
    ] = None,
    out: Path = _MAPPING,
    topic: str | None = None,
    episode: int | None = None,
    columns: str | None = None,
    mapping: Path | None = None,
    page: Path | None = None,
    as_json: bool = False,
) -> None:
    """Say what a log holds, and write how to read it.

    Columns or topics are matched to the robot's joints by name, else by number; units are read
    from names, limits, velocities and gravity. Where two readings fit, the question stands under
    `undecided:` in the mapping, which cannot be used before it is answered: state what is meant,
    and delete the question. A mapping that is there and reads otherwise is not written over. With
    --mapping, an answered one is tried.

    Then it says what the recording is worth: sampling, quantisation, dropouts, on which side of the
    gear the torque was measured, and which parameters the motion says nothing about.

    Every command that takes a recording takes the log itself, too, with `--mapping`, or without
    one where nothing is left to be decided.

    Args:
        log: The log: a file, or the folder of a bag.
        out: Where to write the mapping.
        topic: Topic of the joint states of a bag, if there are several.
        episode: Episode of a LeRobotDataset; all if not given.
        columns: Patterns of the columns that count beside the time, with commas between: of two
            arms in one log, 'left_*'.
        mapping: Say what the log is worth as this mapping reads it, and write none.
        page: Write a page (.html) with every column over time, the arm that moves with them, and
            which parameters the motion shows.
        as_json: Print the findings as JSON.

    Examples:
        limo inspect log.csv --robot iiwa14
        limo inspect log.csv --page log.html
        limo inspect log.csv --robot iiwa14 --mapping mapping.yaml --page log.html
        limo convert log.csv --mapping mapping.yaml --out run.parquet
    """
    from limo_driver.app.library.inspecting import inspect, save_page
    from limo_driver.logs.readers.inspection import Settled, settle
    from limo_driver.logs.readers.proposals.proposal import NothingProposedError

    inputs = [item for item in (log, mapping) if item is not None and item.is_file()]
    if page is not None:
        require_page(page, inputs)
    if robot is None:
        _show_columns(log, page, topic, episode)
        return
    require_file(out, [log] if log.is_file() else [])
    try:
        found = inspect(log, robot, topic=topic, episode=episode, columns=columns, mapping=mapping)
    except NothingProposedError as error:
        if page is not None:
            _show_columns(log, page, topic, episode)
        raise _with_template(error, out) from None
    if mapping is not None:
        settled = Settled(mapping, found.mapping, True, (f"read as {mapping} says",))
    else:
        settled = settle(found, out, log.name.partition(".")[0])
    if page is not None:
        save_page(found, page)
    if as_json:
        _print_json(found, settled)
    else:
        _show(found, settled)
        _show_next(found, log, robot, settled)
        if page is not None:
            terminal().print(f"wrote {page}")


def _show_columns(log: Path, page: Path | None, topic: str | None, episode: int | None) -> None:
    """Write the page of a log of which no robot is known."""
    from limo_driver.app.library.inspecting import save_columns

    if page is None:
        raise ConfigError("--robot: is needed to read a log; without one, --page shows its columns")
    save_columns(log, page, topic=topic, episode=episode)
    terminal().print(f"wrote {page}: columns as logged")


def _with_template(error: NothingProposedError, out: Path) -> RecordingError:
    """Return the error with where a mapping is to be filled in, which is written there."""
    where = f"kept {out}, which is there: for a mapping to be filled in, name another file by --out"
    if not out.exists():
        with whole(out) as draft:
            draft.write_text(error.template, encoding="utf-8")
        where = f"wrote {out}, a mapping to be filled in: name the columns there"
    return RecordingError(f"{error}; {where}")


def _print_json(found: Inspection, settled: Settled) -> None:
    import json

    taken = {
        item.quantity: {"columns": item.columns, "unit": item.unit, "because": item.why}
        for item in found.proposal.taken
    }
    values = {
        "mapping": str(settled.path),
        "kept": settled.is_kept,
        "kind": found.table.kind,
        "rows": found.table.rows,
        "taken": taken,
        "telemetry": list(found.telemetry),
        "undecided": list(found.questions),
        "notes": list(found.notes()),
    }
    terminal().print_json(json.dumps(values))


def _show(found: Inspection, settled: Settled) -> None:

    console = terminal(soft_wrap=True)
    for line in (*str(found).splitlines(), *settled.told):
        console.print(in_options(line))


def _show_next(found: Inspection, log: Path, robot: str, settled: Settled) -> None:
    """Say what to do with the mapping."""
    console, path = terminal(soft_wrap=True), settled.path
    if open_ones := len(settled.mapping.undecided):
        what = "the question" if open_ones == 1 else f"each of the {open_ones} questions"
        where = f"in {path}" if settled.is_kept else "there"
        console.print(
            f"next: answer {what} under `undecided:` {where}, and delete it", style="bold"
        )
    elif settled.is_kept or found.recording is not None:
        option = "--sim" if _states_friction(found.proposal.model) else "--robot"
        words = ("limo", "diagnose", log, option, robot, "--mapping", path)
        console.print(f"next: {in_shell(*words)} --out diagnosis", style="bold")
    elif found.mapping.torque is None:
        console.print(
            f"next: name the columns of torques, of currents (with `factor:`) or of commands under "
            f"`torque:` or `command:` in {path}",
            style="bold",
        )


def _states_friction(model: RobotModel) -> bool:
    """Say whether an MJCF file states friction, which counts as unknown where it is no `--sim`."""
    from limo_driver.physics.described import described_effects
    from limo_driver.physics.effect import Friction

    is_mjcf = model.description.kind == "MJCF"
    return is_mjcf and any(isinstance(effect, Friction) for effect in described_effects(model))
