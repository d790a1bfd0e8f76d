"""Motions to record: locally isotropic ones, and those that identify a robot best."""

from __future__ import annotations

from typing import TYPE_CHECKING

from limo_driver.model import RobotModel

if TYPE_CHECKING:
    from collections.abc import Callable

    from estimators.rigid_body.conditioning import Conditioning
    from limopa import Excitation, ExcitationRequest, Plan, PlanRequest


def plan(
    robot: RobotModel | str,
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
        >>> plan("iiwa14", PlanRequest(scaffolds=4), seed=1).trajectory.save("limo.traj.parquet")
    """
    import limopa

    return limopa.plan(model_of(robot), request, seed, progress)


def excite(
    robot: RobotModel | str,
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
        >>> excite("iiwa14", ExcitationRequest(duration=30.0)).trajectory.save("excite.parquet")
    """
    from threadpoolctl import threadpool_limits

    import limopa
    from estimators.rigid_body.conditioning import Conditioning

    model = model_of(robot)
    with threadpool_limits(limits=1, user_api="blas"):  # its matrices are small; more only wait
        criterion = conditioning or Conditioning(model)
        return limopa.excite(model, criterion, request, seed, progress)


def model_of(robot: RobotModel | str) -> RobotModel:
    """Return a robot, or the one of this built-in name or URDF."""
    return robot if isinstance(robot, RobotModel) else RobotModel.load(robot)
