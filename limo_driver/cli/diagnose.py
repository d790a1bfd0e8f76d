"""`limo diagnose`: what physics a simulation leaves out of recordings."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from rich.console import Console
    from rich.table import Table

    from estimators.diagnosis.result import Diagnosis, Replay
    from estimators.diagnosis.verdict import Verdict
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

VERDICT, IMPROVED, REPORT = "verdict.json", "sim.yaml", "report.html"
NEXT_MOTION = "next_motion.parquet"
REPLAYED = (12.0, 5.0)  # [s] of recorded motion that the simulated robot follows; with many effects
MANY_EFFECTS = 40  # of which most are evaluated in every cycle, one by one
REPLAY_RATE = 100.0  # [Hz] of the rows that are kept of it
START_POSES = 6  # of each recording, around which a next motion is tried


def command(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings of one arm.")],
    sim: Annotated[Path, typer.Option(help="What is believed of that arm, a sim.yaml.")],
    out: Annotated[Path, typer.Option(help="Folder for verdict, improved simulation and report.")],
    bandwidth: Annotated[
        float, typer.Option(help="Bandwidth of the zero-phase filter on motion and torque [Hz].")
    ] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the verdict as JSON.")] = False,
) -> None:
    r"""Say where a simulation and recordings differ, what physics was left out, and mend it.

    Writes verdict.json, sim.yaml (the improved simulation), report.html, and next_motion.parquet
    where one more motion would decide between explanations. A finished diagnosis ends with exit
    status 0, whatever it finds.

    Examples:
        limo diagnose monday.parquet tuesday.parquet --sim sim.yaml \
            --out diagnosis
        limo run --backend mujoco --trajectory diagnosis/next_motion.parquet \
            --record next.parquet
    """
    import json
    import sys

    from limo_driver.console.terminal import terminal
    from limo_driver.outputs import require_folder
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

    simulation = Simulation.load(sim)
    measured = [Recording.load(path) for path in recordings]
    for recording in measured:
        recording.check_robot(simulation.model)
    names = (VERDICT, IMPROVED, REPORT, NEXT_MOTION)
    require_folder(out, "the diagnosis", names, [sim, *recordings])
    notes = terminal(stderr=True, soft_wrap=True)
    with _progress(notes) as progress:
        found = _diagnose(simulation, measured, bandwidth, progress)
        _write(found, out)
        progress("done", 1.0)
    if as_json:
        sys.stdout.write(json.dumps(found.verdict.as_values(), indent=1) + "\n")
        return
    for recording in measured:
        for item in (*recording.warnings, *recording.left_out):
            notes.print(f"{recording.source}: {item}")
    _show(found, out)


def _diagnose(
    simulation: Simulation,
    measured: list[Recording],
    bandwidth: float,
    progress: Callable[[str, float], None],
) -> Diagnosis:
    from estimators.diagnosis import diagnose

    found = diagnose(
        simulation, measured, bandwidth, lambda stage, part: progress(stage, 0.85 * part)
    )
    progress("planning the next motion", 0.85)
    found = with_next_motion(found)
    progress("replaying on the simulated robot", 0.9)
    return with_replay(found)


def with_next_motion(found: Diagnosis) -> Diagnosis:
    """Add the motion that tells apart what the recordings cannot, if there is one."""
    from dataclasses import replace

    from estimators.diagnosis.verdict import NextMotion
    from limo_driver.errors import LimoError
    from limopa.separation.separation import motion_for, purpose_of

    refused = ""
    for pair, joints in _ambiguous(found.verdict, found.before.model.n):
        try:
            motion = motion_for(found.before.model, joints, pair, _start_poses(found.recordings))
        except LimoError as error:
            refused = refused or f"No next motion: {error}."
            continue
        wanted = NextMotion((pair,), NEXT_MOTION)
        return replace(
            found,
            verdict=replace(found.verdict, next_motion=wanted),
            next_motion=motion,
            next_motion_purpose=purpose_of(pair, joints),
        )
    verdict = replace(found.verdict, next_motion=None)
    return replace(found, verdict=verdict, next_motion=None, next_motion_purpose=refused)


def _ambiguous(
    verdict: Verdict, n: int
) -> Generator[tuple[tuple[str, str], tuple[int, ...]], None, None]:
    """Yield pairs of effects that the recordings cannot tell apart, and their joints."""
    every = tuple(range(1, n + 1))
    wanted = verdict.next_motion.separates if verdict.next_motion else ()
    for pair in wanted:
        joints = [item.joints for item in verdict.findings if item.effect in pair]
        yield pair, (joints[0] if joints else ()) or every
    for item in verdict.findings:
        for other in item.equivalent:
            if (item.effect, other) not in wanted:
                yield (item.effect, other), item.joints or every


def _start_poses(recordings: Sequence[Recording]):  # noqa: ANN202  # (k, n) [rad]
    import numpy as np

    return np.concatenate(
        [r.position[np.linspace(0, len(r) - 1, START_POSES).astype(int)] for r in recordings]
    )


def with_replay(found: Diagnosis) -> Diagnosis:
    """Add what the simulated robot measures when it follows the recorded motion."""
    from dataclasses import replace

    from limo_driver.errors import LimoError

    try:
        return replace(found, replay=(_replay(found),))
    except LimoError as error:
        return replace(found, replay_note=f"The motion was not replayed: {error}.")


def _replay(found: Diagnosis) -> Replay:
    """Replay the stretch in which recording and simulation differ most."""
    import numpy as np

    from backends.mujoco_sim.replay import follow
    from estimators.diagnosis.report import worst_stretch
    from estimators.diagnosis.result import Replay

    floor = np.array(found.verdict.fit.noise_floor)
    duration = REPLAYED[len(found.after.effects) > MANY_EFFECTS]
    worst = worst_stretch(found.traces, floor, duration)
    recording = found.recordings[worst.recording]
    stretch = (recording, worst.start, worst.stop, found.bandwidth)
    before = follow(found.before, *stretch)
    after = before if found.after == found.before else follow(found.after, *stretch)
    rows = (recording.time >= worst.start) & (recording.time <= worst.stop)
    every = slice(None, None, max(1, int(recording.rate / REPLAY_RATE)))
    time = before.time[every]
    scored = np.searchsorted(found.traces.time[worst.rows], time, side="right") - 1
    return Replay(
        time=time,
        measured=recording.filtered_torque(found.bandwidth)[rows][every],
        before=before.torque[every],
        after=after.torque[every],
        tracking=after.tracking,
        moving=found.traces.moving[worst.rows][np.maximum(scored, 0)],
        recording=worst.recording,
    )


def _write(found: Diagnosis, out: Path) -> None:
    from estimators.diagnosis.report import write_report
    from limo_driver.errors import ConfigError

    try:
        found.verdict.save(out / VERDICT)
        found.after.save(out / IMPROVED)
        write_report(found, out / REPORT)
        (out / NEXT_MOTION).unlink(missing_ok=True)  # of a diagnosis before this one
        if found.next_motion is not None:
            found.next_motion.save(out / NEXT_MOTION)
    except OSError as error:
        raise ConfigError(f"cannot be written to: {error}", path=out) from None


@contextmanager
def _progress(console: Console) -> Generator[Callable[[str, float], None]]:
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.description}", markup=False))
    # where nobody watches, the bar would leave an empty line before the message of an error
    disable = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=disable) as bar:
        task = bar.add_task("reading motion", total=1.0)
        yield lambda stage, part: bar.update(task, completed=part, description=stage)


def _show(found: Diagnosis, out: Path) -> None:
    from limo_driver.console.terminal import terminal
    from limo_driver.physics import spoken

    console = terminal()
    verdict = found.verdict
    console.print(verdict.sentence(), style="bold")
    for item in verdict.findings:
        same = ", ".join(spoken(other) for other in item.equivalent)
        console.print(f"{item.evidence}")
        console.print(
            f"  confidence {item.confidence:.0%}" + (f"; cannot be told from {same}" * bool(same)),
        )
    console.print(_errors(verdict))
    for note in verdict.notes:
        console.print(f"note: {note}")
    if found.next_motion is not None:
        console.print(f"next motion: {found.next_motion_purpose}")
    console.print(f"wrote {out / REPORT}")


def _errors(verdict: Verdict) -> Table:
    from rich.table import Table

    table = Table("joint", title="held-out RMSE [N m]", title_justify="left")
    fit = verdict.fit
    columns = {"given": fit.heldout_rmse_before, "tolerances alone": fit.heldout_rmse_tolerances,
               "improved": fit.heldout_rmse_after, "noise floor": fit.noise_floor}  # fmt: skip
    told = {heading: values for heading, values in columns.items() if values}
    for heading in told:
        table.add_column(heading, justify="right")
    for j, values in enumerate(zip(*told.values(), strict=True), start=1):
        table.add_row(str(j), *(f"{value:.4f}" for value in values))
    return table
