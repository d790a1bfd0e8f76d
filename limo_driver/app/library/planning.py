"""Motions to record: locally isotropic ones, and those that identify a robot best."""

from __future__ import annotations

from typing import TYPE_CHECKING

from limo_driver.app.library.inputs import expected, model_of
from limo_driver.runtime.parameters import seed_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from estimators.rigid_body.base_parameters import Conditioning
    from limo_driver.model import RobotModel
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
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Plan:
    """Plan locally isotropic motion: reach poses all over the workspace, and reverse around each.

    Args:
        robot: The arm, or its built-in name or URDF.
        request: Number of poses, sampling rate, workspace, surroundings, speeds; by default the
            paper's: 150 poses, which last about an hour.
        seed: Of every random draw; the same request and seed give the same plan.
        progress: Told the poses done and those wanted.

    Returns:
        The plan, its motion in `trajectory`.

    Raises:
        InfeasiblePathError: No such motion; names the condition that fails.
        ConfigError: There is no such robot, or its collision shapes cannot be read.

    Example:
        >>> found = limo.plan("iiwa14", limo.PlanRequest(scaffolds=4), seed=1)
        >>> found.trajectory.save("limo.traj.parquet")
    """
    import limopa

    wanted = expected("request", request or limopa.PlanRequest(), limopa.PlanRequest)
    return limopa.plan(model_of(robot), wanted, seed_of(seed), progress)


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
