"""`limo drives`: simulated drives as participants of a real bus."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.command_line import describe_options
from limo_driver.app.console.terminal import say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from backends.can.config import ArmConfig
    from limo_driver.types import FloatArray


@describe_options
def command(
    *,
    config: Path,
    sim: Path | None = None,
    scenario: Path | None = None,
    trajectory: Path | None = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    duration: Annotated[float | None, typer.Option(min=0.0)] = None,
    fifo: bool = False,
    as_json: bool = False,
) -> None:
    r"""Be the drives of an arm on its CAN bus, with a simulated arm behind them.

    One MuJoCo simulation moves all joints. Standard output says when they are ready. The other end
    of the bus is `limo run --backend can` with the same configuration, in another process, or any
    other master.

    Args:
        config: The arm (arm.yaml): its bus, its drives.
        sim: A sim.yaml of the arm; else its rigid body alone.
        scenario: What goes wrong, and when (YAML).
        trajectory: The arm stands where it starts; else in the middle of its range.
        seed: Seed of the sensor noise.
        duration: Stop after this time [s]; else at Ctrl-C.
        fifo: Ask for SCHED_FIFO and locked memory.
        as_json: Say that they are ready, and the summary, as JSON.

    Examples:
        limo drives --config arm.yaml --trajectory limo.traj.parquet
        limo drives --config arm.yaml --sim sim.yaml --scenario lost_frames.yaml \
            --duration 60
    """
    from backends.can.config import ArmConfig
    from backends.can.simulator.scenario import BusScenario
    from backends.can.simulator.session import run_drives
    from limo_driver.physics import Simulation

    arm = ArmConfig.load(config)
    faults = None if scenario is None else BusScenario.load(scenario, arm.joints)
    simulation = Simulation(robot=arm.robot) if sim is None else Simulation.load(sim)
    position = None if trajectory is None else _start_of(trajectory, arm)

    def ready(refused: Sequence[str]) -> None:
        for each in refused:
            say(f"not permitted: {each}", stderr=True)
        nodes = [joint.node for joint in arm.joints]
        where = f"{arm.bus.interface} {arm.bus.channel}"
        if as_json:
            typer.echo(json.dumps({"ready": True, "bus": where, "nodes": nodes}))
        else:
            say(f"ready: {len(nodes)} {arm.convention} drives on {where}, nodes {nodes}")

    counts = run_drives(
        arm,
        simulation,
        ready,
        fifo=fifo,
        position=position,
        seed=seed,
        scenario=faults,
        duration=duration,
    )
    if as_json:
        typer.echo(json.dumps(counts.as_json()))
        return
    faults_begun = ", ".join(counts.faults) or "none"
    say(
        f"{counts.heard} frames heard, {counts.sent} sent, {counts.syncs} cycles, "
        f"{counts.lost} lost, {counts.babbled} babbled; faults: {faults_begun}"
    )


def _start_of(path: Path, arm: ArmConfig) -> FloatArray:
    """Return where a trajectory starts, (n,) [rad], if it is one of this arm."""
    from limo_driver.trajectory import Trajectory

    motion = Trajectory.load(path)
    motion.check_robot(arm.model.n, arm.model.name)
    return motion.position[0]
