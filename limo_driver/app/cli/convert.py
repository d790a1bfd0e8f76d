"""`limo convert`: logs of any format as a recording, and a recording as an MCAP log."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limo_driver.app.console.command_line import ROBOTS, MappingOption, describe_options
from limo_driver.app.console.terminal import progress, terminal
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import require_file, require_parquet, whole

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from limo_driver.app.library.converting import Converted

_MCAP = ".mcap"
_FOXGLOVE = ".json"
_LAYOUTS = (_FOXGLOVE, ".xml")
_TOPIC = "/joint_states"


@describe_options
def command(
    files: list[Path],
    *,
    out: Path,
    robot: Annotated[
        str | None, typer.Option(help=f"Whose joints are meant, in their order: {ROBOTS}.")
    ] = None,
    topic: str | None = None,
    mapping: MappingOption = None,
    episode: int | None = None,
    as_json: bool = False,
) -> None:
    """Make a recording of a log: of limo, a ROS 2 bag, or of any format with a mapping.

    Text, Parquet, .npz, JSON, .mat and LeRobotDatasets need --robot, and --mapping where their
    columns leave something to be decided: see `limo inspect`. Of a bag the joint states are read.

    Time is the stamp of each message, from the first on, in order of the stamps. Messages that were
    lost leave gaps; duplicates stay in the file and are left out where it is read. A log that was
    cut off is read as far as it goes. If --out ends in .mcap, a recording becomes a log instead.

    If it ends in .json or .xml, it is a layout in which Foxglove or PlotJuggler shows that log:
    measured and estimated torque of each joint, what is left, and events. PlotJuggler opens
    recordings, too.

    Args:
        files: MCAP or .db3 logs or folders of them; or one log of any format.
        out: The recording to write (Parquet), a .mcap log, or a layout (.json, .xml).
        topic: Topic of the joint states, if there are several.
        episode: Episode of a LeRobotDataset; all if not given.
        as_json: Print the counts as JSON.

    Examples:
        limo convert logs/ --robot iiwa14 --out run.parquet
        limo convert bag_0.db3 --topic /joint_states --out run.parquet
        limo convert log.csv --mapping mapping.yaml --out run.parquet
        limo convert run.parquet --out run.mcap
        limo convert logs/ --out foxglove.json
    """
    require_file(out, files)
    if out.suffix == _MCAP:
        from limo_driver.app.library.reading import read
        from limo_driver.logs.ros.joint_state_log import write_joint_states
        from limo_driver.model import RobotModel

        if len(files) > 1:
            raise ConfigError(f"{len(files)} files to make one log of, expected one recording")
        model = None if robot is None else RobotModel.load(robot)
        recording = read(files[0], model, mapping)
        joints, start_ns = _named(files[0], recording.n)
        if model is not None:
            joints = model.joint_names
        write_joint_states(recording, out, joints, topic or _TOPIC, start_ns)
        counts = {"topic": topic or _TOPIC, "joints": list(joints), "samples": len(recording)}
        counts |= {"duration": recording.duration}
        left = [f"{name} is left behind" for name in recording.extras]
        notes = [*recording.warnings, *map(str, recording.left_out), *left]
        _report(out, counts, notes, as_json=as_json)
        return
    if out.suffix in _LAYOUTS:
        _refuse_for_layout(out, robot=robot, topic=topic, mapping=mapping, episode=episode)
        _to_layout(files, out)
        return
    require_parquet(out)
    if mapping is None and all(map(_is_bag, files)):
        _to_recording(files, out, robot, topic, as_json=as_json)
    else:
        from limo_driver.app.library.converting import convert_log
        from limo_driver.model import RobotModel

        if len(files) > 1:
            raise ConfigError(
                f"{len(files)} logs to convert, expected one, or bags without a mapping"
            )
        model = None if robot is None else RobotModel.load(robot)
        found = convert_log(files[0], out, model, mapping, topic, episode)
        _report(out, _counts(found), list(found.notes), as_json=as_json)


def _refuse_for_layout(out: Path, **options: object) -> None:
    """Refuse what says how a log is to be read: a layout only shows it."""
    given = [f"--{name}" for name, value in options.items() if value is not None]
    if given:
        raise ConfigError(
            f"a layout ({' or '.join(_LAYOUTS)}) shows a log as it is and takes no "
            f"{' or '.join(given)}; a recording is written to a .parquet file",
            path=out,
        )


def _to_layout(files: list[Path], out: Path) -> None:
    from limo_driver.logs.ros.layouts import foxglove_layout, logged_topics, plotjuggler_layout

    if files[0].suffix in {".parquet", ".pq"}:
        _to_recording_layout(files, out)
        return
    for file in files:
        if not _is_bag(file):
            raise ConfigError(
                "a layout is of limo's logs, of bags, or of recordings (.parquet); "
                "`limo convert` makes one of any log first",
                path=file,
            )
    log = logged_topics(files)
    made = foxglove_layout(log) if out.suffix == _FOXGLOVE else plotjuggler_layout(log)
    with whole(out) as draft:
        draft.write_text(made, encoding="utf-8")
    topics = ", ".join(topic for topic in (log.states, log.estimates, log.events) if topic)
    terminal(soft_wrap=True).print(f"wrote {out}: {len(log.joints)} joints of {topics}")


def _to_recording_layout(files: list[Path], out: Path) -> None:
    from limo_driver.app.library.reading import column_names
    from limo_driver.logs.ros.layouts import recording_layout

    if out.suffix == _FOXGLOVE:
        raise ConfigError(
            "is a recording; Foxglove opens logs: --out run.mcap first", path=files[0]
        )
    columns = column_names(files[0])
    with whole(out) as draft:
        draft.write_text(recording_layout(columns), encoding="utf-8")
    terminal(soft_wrap=True).print(f"wrote {out}: {len(columns)} columns of {files[0]}")


def _is_bag(path: Path) -> bool:
    from limo_driver.logs.readers.formats.lerobot import is_dataset
    from limo_driver.logs.readers.formats.reading import ARRAYS, OBJECTS, PARQUET, TEXTS, ending_of

    if path.is_dir():
        return not is_dataset(path)
    return ending_of(path) not in {*ARRAYS, *OBJECTS, *PARQUET, *TEXTS}


def _to_recording(
    files: list[Path], out: Path, robot: str | None, topic: str | None, *, as_json: bool
) -> None:
    from limo_driver.app.library.converting import convert_bags
    from limo_driver.model import RobotModel

    model = None if robot is None else RobotModel.load(robot)
    with _progress(quiet=as_json) as progress:
        found = convert_bags(files, out, model, topic, progress)
    counts = {"topic": found.topic, **_counts(found.whole)}
    counts |= {name: getattr(found, name) for name in ("duplicates", "reordered", "malformed")}
    counts |= {"of other joints": found.elsewhere}
    _report(out, counts, list(found.whole.notes), as_json=as_json)


def _counts(found: Converted) -> dict[str, Any]:
    rows = {"samples": found.samples, "usable": found.usable, "duration": found.duration}
    return {"joints": list(found.joints), **rows}


def _named(path: Path, n: int) -> tuple[tuple[str, ...], int]:
    """Return the joints and the stamp of time 0 [ns] that the header of a recording may name."""
    import pyarrow.parquet as pq

    from limo_driver.recordings.files.recorder import header_of

    numbered = tuple(f"joint_{j + 1}" for j in range(n))
    if path.suffix != ".parquet":
        return numbered, 0
    header = header_of(pq.read_schema(path))
    match header:
        case {"joints": [*joints]} if len(joints) == n:
            names = tuple(str(joint) for joint in joints)
        case _:
            names = numbered
    match header:
        case {"provenance": {"start_ns": int(start_ns)}}:
            return names, start_ns
        case _:
            return names, 0


@contextmanager
def _progress(*, quiet: bool) -> Generator[Callable[[int, int], None]]:
    from rich.progress import SpinnerColumn, TimeElapsedColumn

    how_far = "reading: {task.fields[messages]} messages, {task.completed} files done"
    with progress(SpinnerColumn(), how_far, TimeElapsedColumn(), quiet=quiet) as bar:
        task = bar.add_task("reading", messages=0)
        yield lambda files, messages: bar.update(task, completed=files, messages=messages)


def _report(out: Path, counts: dict[str, Any], notes: list[str], *, as_json: bool) -> None:

    if as_json:
        terminal().print_json(data={"file": str(out), **counts, "notes": notes})
        return
    errors = terminal(stderr=True, soft_wrap=True)
    for note in notes:
        errors.print(note)
    console = terminal(soft_wrap=True)
    console.print(
        f"{out}: {counts['samples']} samples of {len(counts['joints'])} joints over "
        f"{counts['duration']:.3f} s" + (f", topic {counts['topic']}" if "topic" in counts else ""),
    )
    for name in ("duplicates", "reordered", "malformed", "of other joints"):
        if counts.get(name):
            console.print(f"{counts[name]} messages {_MEANING[name]}")


_MEANING = {
    "duplicates": "have the stamp of another one",
    "reordered": "were logged after one with a later stamp; they are in order of the stamps now",
    "malformed": "could not be decoded and are not in the recording",
    "of other joints": "lack joints of the robot and are not in the recording",
}
