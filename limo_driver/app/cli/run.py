"""`limo run`: move an arm along a trajectory and record it."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limo_driver.app.cli import INTERRUPTED
from limo_driver.app.console.command_line import ROBOTS, RosDomain, SessionOptions, describe_options
from limo_driver.app.console.terminal import progress, say, terminal
from limo_driver.errors import BackendError, ConfigError, HoldingError
from limo_driver.runtime.outputs import require_apart

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from limo_driver.robot.playback import PlaybackSummary

_ANSWERED = {"p50": "p50", "p99": "p99", "p99_9": "p99.9", "longest": "longest"}


@describe_options
def command(
    *,
    backend: str,
    trajectory: Path,
    record: Path,
    sim: Path | None = None,
    robot: Annotated[str | None, typer.Option(help=f"Else the trajectory's: {ROBOTS}.")] = None,
    host: str | None = None,
    port: int | None = None,
    arm_config: Annotated[Path | None, typer.Option("--config")] = None,
    reset_faults: bool = False,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    duration: Annotated[float | None, typer.Option(min=0.0)] = None,
    rate: float | None = None,
    impedance: Annotated[float | None, typer.Option(min=0.0)] = None,
    stream: bool = False,
    wait: Annotated[float | None, typer.Option("--wait-for-estimates", metavar="SECONDS")] = None,
    name: str | None = None,
    ros: bool = False,
    ros_domain: RosDomain = 0,
    network: SessionOptions,
    fifo: bool = False,
    as_json: bool = False,
) -> None:
    r"""Move an arm along a trajectory and record position, velocity and torque.

    A simulated arm starts where the trajectory does; a real one has to stand there. Ctrl-C
    or SIGTERM slows the arm down to a hold, keeps what was recorded, and ends with exit status 130.

    Args:
        backend: Name of the backend: mujoco, virtual, ...
        trajectory: The motion, from `limo plan` or `excite`.
        record: Where to write the recording (Parquet).
        sim: A sim.yaml for simulated arms; else the rigid body alone.
        host: Address of a real arm's controller; else whoever speaks.
        port: UDP port of a real arm.
        arm_config: What is to be known of a real arm (YAML).
        reset_faults: Reset the faults of a real arm's drives.
        seed: Seed of a simulated arm's sensor noise.
        duration: Stop after this much of the trajectory [s].
        rate: Record and publish at this rate [Hz], a part of the control rate.
        impedance: Follow with this joint stiffness [N m/rad] instead of stiffly.
        stream: Publish joint states on Zenoh, in real time.
        wait: With --stream: stand at the start until `limo serve` answers, at most so long; without
            an answer the arm does not move, and the exit status is 1.
        name: Name of the arm on the network; else the robot's.
        ros: With --stream: also as /joint_states of ROS 2 (rmw_zenoh).
        fifo: Ask for SCHED_FIFO and locked memory, for a real arm.
        as_json: Print the summary as JSON.

    Examples:
        limo run --backend mujoco --trajectory limo.traj.parquet --sim sim.yaml \
            --record run.parquet
        limo run --backend virtual --trajectory limo.traj.parquet \
            --record ideal.parquet --json
        limo run --backend mujoco --trajectory limo.traj.parquet \
            --record run.parquet --stream
        limo run --backend fri --trajectory limo.traj.parquet \
            --record run.parquet --fifo
    """
    from limo_driver.app.library.moving import Streaming, play
    from limo_driver.physics import Simulation
    from limo_driver.robot.playback import NotBegunError
    from limo_driver.trajectory import Trajectory

    if wait is not None and not stream:
        raise ConfigError("--wait-for-estimates waits for what answers --stream; give both")
    if ros and not stream:
        raise ConfigError("--ros publishes what --stream does; give both")
    domain = ros_domain if ros else None
    streaming = Streaming(name or "", wait, domain, *network.ends)
    require_apart([record], [trajectory, *([] if sim is None else [sim])])
    motion = Trajectory.load(trajectory)
    if duration is not None:
        motion = motion.first(duration)
    simulation = None if sim is None else Simulation.load(sim)
    try:
        with _progress(quiet=as_json) as progress:
            summary = play(
                backend,
                motion,
                record,
                simulation=simulation,
                robot=robot,
                seed=seed,
                rate=rate,
                stiffness=impedance,
                fifo=fifo,
                link={
                    "host": host,
                    "port": port,
                    "config": arm_config,
                    "reset_faults": reset_faults or None,
                },
                stream=streaming if stream else None,
                about={"sim": None if sim is None else sim.name},
                standing=_say_it_stands,
                progress=progress,
            )
    except NotBegunError:
        typer.echo("limo: interrupted before the arm moved; nothing was recorded", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except HoldingError as error:
        raise BackendError(_how_to_go_on(error.reason, record, fifo=fifo)) from error
    _report(summary, as_json=as_json)
    if summary.interrupted:
        raise typer.Exit(INTERRUPTED)


def _how_to_go_on(reason: str, record: Path, *, fifo: bool) -> str:
    """Return what somebody at the arm can do: `resume` is for programs."""
    kept = f"what it did until then is in {record}; " if record.exists() else ""
    late = "" if fifo else ", with --fifo if this machine was late"
    again = f"bring it back to the first pose and run again{late}"
    return f"the arm holds ({reason}); {kept}{again}"


def _say_it_stands(name: str) -> None:
    say(f"{name} stands until estimates of its torque come", stderr=True)


@contextmanager
def _progress(*, quiet: bool) -> Generator[Callable[[int, int], None]]:
    from rich.progress import BarColumn, TimeRemainingColumn

    with progress("{task.description}", BarColumn(), TimeRemainingColumn(), quiet=quiet) as bar:
        task = bar.add_task("moving and recording")
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _report(summary: PlaybackSummary, *, as_json: bool) -> None:
    import pyarrow.parquet as pq
    from rich.table import Table

    from limo_driver.recordings.gate.doubts import about_gaps

    console = terminal()
    if as_json:
        console.print_json(data=summary.as_json())
        return
    table = Table("joint", "tracking rms [mrad]", "max [mrad]")
    for j, (rms, most) in enumerate(
        zip(summary.tracking_rmse, summary.tracking_max, strict=True), start=1
    ):
        table.add_row(str(j), f"{1e3 * rms:.3f}", f"{1e3 * most:.3f}")
    console.print(
        f"{summary.record}: {summary.samples} samples, {summary.duration:.3f} s, "
        f"{summary.real_time_factor:.1f} times real time"
        + (", interrupted: the arm holds" if summary.interrupted else ""),
        soft_wrap=True,
    )
    console.print(table)
    time = pq.read_table(summary.record, columns=["time"])["time"].to_numpy()
    for gaps in about_gaps(time):
        console.print(f"{gaps}: states that never came, or too late", soft_wrap=True)
    if summary.link:
        console.print(_link_line(summary.link), soft_wrap=True)
    for refused in summary.refused:
        console.print(f"not permitted: {refused}", soft_wrap=True)
    for name, count in summary.limited.items():
        console.print(f"limited by {name.replace('_', ' ')} in {count} cycles")


def _link_line(link: dict[str, Any]) -> str:
    """Say how fast packets were answered, and all that went wrong and is not zero."""
    answer = link.get("answer", {})
    times = ", ".join(
        f"{said} {1e3 * answer[key]:.2f} ms" for key, said in _ANSWERED.items() if key in answer
    )
    counts = ", ".join(
        f"{count} {name.replace('_', ' ')}"
        for name, count in link.items()
        if isinstance(count, int) and count
    )
    return f"link: {counts}" + (f"; answered within {times}" if times else "")
