"""Plan motions, move an arm along them and record it, and stream what it measures meanwhile.

Motions are locally isotropic, or those that identify a robot best.
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from limo_driver.app.library.inputs import expected, model_of, recording_of, simulation_of
from limo_driver.errors import ConfigError
from limo_driver.robot.playback import Playback, cycles_per_row, kept_in, recorded, trajectory_of
from limo_driver.robot.registry import open_for
from limo_driver.runtime.outputs import require_parquet
from limo_driver.runtime.parameters import seed_of

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence

    from estimators.rigid_body.base_parameters import Conditioning
    from limo_driver.model import RobotModel
    from limo_driver.network.readiness import FirstEstimate
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.robot.playback import PlaybackSummary
    from limo_driver.robot.robot import Robot
    from limo_driver.trajectory import Planned, Trajectory
    from limo_driver.types import JointState
    from limopa import (
        Excitation,
        ExcitationRequest,
        Plan,
        PlanRequest,
        ServoExcitation,
        ServoRequest,
    )


def plan(
    robot: RobotModel | Path | str,
    request: PlanRequest | None = None,
    *,
    near: Recording | Path | str | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Plan:
    """Plan locally isotropic motion: reach poses all over the workspace, and reverse around each.

    Args:
        robot: The arm, or its built-in name or URDF.
        request: Number of poses, sampling rate, workspace, surroundings, speeds; by default the
            paper's: 150 poses, which last about an hour.
        near: Recording of this arm at work, or its file: poses are drawn around those in it instead
            of all over the workspace, and the flange is no faster than there.
        seed: Of every random draw; the same request and seed give the same plan.
        progress: Told the poses done and those wanted.

    Returns:
        The plan, its motion in `trajectory`.

    Raises:
        InfeasiblePathError: No such motion; names the condition that fails.
        ConfigError: There is no such robot, its collision shapes cannot be read, or nothing moves
            in the recording.
        RecordingError: The recording is of another robot, or cannot be used.

    Example:
        >>> found = limo.plan("iiwa14", limo.PlanRequest(scaffolds=4), seed=1)
        >>> found.trajectory.save("limo.traj.parquet")
    """
    import limopa

    wanted = expected("request", request or limopa.PlanRequest(), limopa.PlanRequest)
    work = None if near is None else recording_of(near, "near")
    return limopa.plan(model_of(robot), wanted, seed_of(seed), progress, work)


def excite(
    robot: RobotModel | Path | str,
    request: ExcitationRequest | None = None,
    *,
    seed: int = 0,
    conditioning: Conditioning | None = None,
    progress: Callable[[int, int, float], None] | None = None,
) -> Excitation:
    """Find the persistently exciting motion from which `identify` learns most.

    Pose and Fourier coefficients minimise the condition number of the regressor of the base
    parameters, Coulomb and viscous friction of each joint included.

    Args:
        robot: The arm, or its built-in name or URDF.
        request: Duration [s], harmonics of each joint, sampling rate [Hz], surroundings, effort.
        seed: Of every random draw; the same request and seed give the same motion.
        conditioning: Condition number of this robot, where one is at hand; built if not given.
        progress: Told the iterations done, those at most, and the condition number.

    Returns:
        The excitation, its motion in `trajectory`.

    Raises:
        InfeasiblePathError: No pose is feasible, or no motion around one.
        ConfigError: The duration is too short for the harmonics, or there is no such robot.

    Example:
        >>> found = limo.excite("iiwa14", limo.ExcitationRequest(duration=30.0))
        >>> found.trajectory.save("excite.traj.parquet")
    """
    from threadpoolctl import threadpool_limits

    import limopa
    from estimators.rigid_body.base_parameters import Conditioning

    model, seed = model_of(robot), seed_of(seed)
    wanted = expected("request", request or limopa.ExcitationRequest(), limopa.ExcitationRequest)
    with threadpool_limits(limits=1, user_api="blas"):  # its matrices are small; more only wait
        criterion = conditioning or Conditioning(model)
        return limopa.excite(model, criterion, wanted, seed, progress)


def excite_servos(
    robot: RobotModel | Path | str, request: ServoRequest | None = None, *, seed: int = 0
) -> ServoExcitation:
    """Plan commands from which positions alone identify an arm behind position servos.

    Args:
        robot: The arm, or its built-in name, URDF or MJCF.
        request: Duration [s], rate [Hz], speed [rad/s], surroundings.
        seed: Of every random draw; the same request and seed give the same commands.

    Returns:
        The commands, which can be saved as CSV and as a LeRobotDataset.

    Raises:
        InfeasiblePathError: No pose lets a joint move, or no way leads from pose to pose.
        ConfigError: There is no such robot, or its collision shapes cannot be read.

    Example:
        >>> found = limo.excite_servos("iiwa14", limo.ServoRequest(rate=50.0), seed=1)
        >>> found.save("moves.csv")
    """
    import limopa

    wanted = expected("request", request or limopa.ServoRequest(), limopa.ServoRequest)
    return limopa.excite_servos(model_of(robot), wanted, seed_of(seed))


@dataclass(frozen=True)
class Streaming:
    """Where a run publishes its joint states on Zenoh, in real time.

    Args:
        name: Of the arm on the network; the robot's if empty.
        wait_for_estimates: Stand at the start until estimates of the torque come, at most so long
            [s]; None to move at once.
        ros_domain: Publish also as /joint_states in this domain of ROS 2 (rmw_zenoh), if any.
        connect: Endpoint or endpoints to reach, for example `tcp/192.168.1.2:7447`.
        listen: Endpoint or endpoints to be reached at.
        config: Zenoh's own configuration file (JSON5).

    Raises:
        ConfigError: The wait is not above 0.

    Example:
        >>> limo.run("mujoco", "limo.traj.parquet", stream=limo.Streaming(name="left"))
    """

    name: str = ""
    wait_for_estimates: float | None = None
    ros_domain: int | None = None
    connect: Sequence[str] | str = ()
    listen: Sequence[str] | str = ()
    config: Path | str | None = None

    def __post_init__(self) -> None:
        wait = self.wait_for_estimates
        if wait is not None and not wait > 0:
            raise ConfigError(f"wait_for_estimates is {wait:g} s, expected above 0")


def run(
    backend: str,
    trajectory: Trajectory | Planned | Path | str,
    *,
    simulation: Simulation | Path | str | None = None,
    robot: Path | str | None = None,
    seed: int = 0,
    record: Path | str | None = None,
    rate: float | None = None,
    stiffness: float | None = None,
    fifo: bool = False,
    link: Mapping[str, Any] | None = None,
    stream: Streaming | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Open a robot, move it along a trajectory, close it, and return what was measured.

    A simulated arm starts where the trajectory does; a real one has to stand there.

    Args:
        backend: Registered name: mujoco, virtual, fri, can, or one of another distribution.
        trajectory: The motion, or its file, or what was planned around one.
        simulation: Physics of a simulated arm, or its file; without it, the rigid body alone.
        robot: Built-in name or URDF, where neither simulation nor trajectory names it.
        seed: Of a simulated arm's sensor noise.
        record: Parquet file that keeps the recording; a crash loses at most its last second.
        rate: Record, and publish, at this rate [Hz], a part of the control rate; every cycle if
            not given.
        stiffness: Follow as an impedance of this stiffness [N m/rad], not by position.
        fifo: Ask for SCHED_FIFO and locked memory while a real arm moves.
        link: How to reach a real arm: arguments of the backend, such as `host`, `port`, `config`.
        stream: Publish joint states on Zenoh, in real time, as this says.
        progress: Told the control cycles done and those in all, now and then.

    Raises:
        BackendNotFoundError: No such backend; names the known ones.
        ConfigError: The trajectory is of another robot, the backend has no such option, the rate
            is no part of the control rate, the file of the recording has the ending of another
            format, or the network cannot be used so.
        ServiceNotReadyError: No estimates came in time; the arm did not move.
        JointLimitError, HoldingError, RecordingError, KeyboardInterrupt: As for `Robot.follow`.

    Example:
        >>> limo.run("mujoco", "limo.traj.parquet", simulation="sim.yaml")
    """
    with kept_in(record) as path:
        summary = play(
            backend, trajectory, path, simulation=simulation, robot=robot, seed=seed, rate=rate,
            stiffness=stiffness, fifo=fifo, link=link, stream=stream, progress=progress,
        )  # fmt: skip
        return recorded(summary, "" if record is None else str(record))


def play(
    backend: str,
    trajectory: Trajectory | Planned | Path | str,
    record: Path,
    *,
    simulation: Simulation | Path | str | None = None,
    robot: Path | str | None = None,
    seed: int = 0,
    rate: float | None = None,
    stiffness: float | None = None,
    fifo: bool = False,
    link: Mapping[str, Any] | None = None,
    stream: Streaming | None = None,
    about: Mapping[str, Any] | None = None,
    standing: Callable[[str], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> PlaybackSummary:
    """Move an arm as `run` does, and say how it went; the recording is in its file.

    SIGINT or SIGTERM slows the arm down to a hold, which the summary says. The options are those of
    `run`; besides, `about` tells the recording's header more of what made this run, and `standing`
    is told the arm's name on the network when it begins to wait for estimates.

    Raises:
        NotBegunError: SIGINT or SIGTERM came before it moved.
        LimoError: As for `run`.
    """
    require_parquet(record)
    motion, seed = trajectory_of(trajectory), seed_of(seed)
    physics = None if simulation is None else simulation_of(simulation)
    name = None if robot is None else str(robot)
    if stream is not None:
        expected("stream", stream, Streaming)
    with ExitStack() as open_:
        arm = open_.enter_context(
            open_for(backend, motion, simulation=physics, robot=name, seed=seed, link=link)
        )
        provenance = {
            "backend": backend,
            "trajectory": Path(motion.source).name,
            "seed": seed,
            "stiffness": stiffness,
            "limo": version("limo"),
            **(about or {}),
        }
        every = 1 if rate is None else cycles_per_row(rate, arm.spec.period)
        publish = answered = None
        if stream is not None:
            publish, answered = open_.enter_context(_published(arm, stream))
            if answered is not None and standing is not None:
                standing(stream.name or arm.spec.name)
        playback = Playback(motion, record, every, stiffness, provenance, publish, fifo, answered)
        return playback.run(arm, progress or (lambda _done, _all: None))


@contextmanager
def _published(
    arm: Robot, stream: Streaming
) -> Generator[tuple[Callable[[JointState], None], FirstEstimate | None]]:
    """Give what publishes states, and what says whether estimates of them come, if one waits."""
    from limo_driver.network.readiness import FirstEstimate
    from limo_driver.network.ros import RosNode, RosTopic
    from limo_driver.network.streaming import JointStatePublisher, open_session

    topic = None if stream.ros_domain is None else RosTopic(domain=stream.ros_domain)
    if topic is not None and stream.config is not None:
        from limo_driver.network.config import require_passage

        require_passage(Path(stream.config), topic.key, "egress", "`ros_domain`")
    name = stream.name or arm.spec.name
    with ExitStack() as open_:
        session = open_.enter_context(open_session(stream.connect, stream.listen, stream.config))
        arm.keep_time()
        node = None if topic is None else open_.enter_context(RosNode(session, [topic]))
        also = None if node is None else node.publishers[0].publish
        publisher = JointStatePublisher(session, name, arm.spec.joint_names, also)
        publish = open_.enter_context(publisher).publish
        wait = stream.wait_for_estimates
        answered = None
        if wait is not None:
            answered = open_.enter_context(FirstEstimate(session, name, wait))
        yield publish, answered
