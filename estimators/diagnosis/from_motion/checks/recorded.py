"""All that is checked of recorded commands before anything is fitted to them, or simulated.

What is wrong with torques that were commanded: units, motors before their gears, other columns.

What a drive without a servo makes of its command has to move the masses of the arm.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.base import check_different
from estimators.diagnosis.from_motion.checks.commands import check_commands, check_set_points
from estimators.diagnosis.from_motion.checks.timing import check_timing
from estimators.diagnosis.from_motion.fitting.identification import with_servos
from estimators.diagnosis.from_motion.fitting.starts import DELAYS, regressed
from estimators.diagnosis.from_motion.simulation.constants import value_in
from estimators.diagnosis.from_motion.simulation.free_run import MOVED, commands_of
from estimators.diagnosis.from_motion.simulation.loads import loaded_joints
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from estimators.diagnosis.settings import HALF, LITTLE, SOME, TINY
from limo_driver.errors import RecordingError
from limo_driver.model.units import unit_of
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.channels import POSITION, TORQUE, commanded_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.model import RobotModel
    from limo_driver.physics import Simulation
    from limo_driver.recordings.commanded import Commanded
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_TURNS: Final = 3.0 * np.pi  # [rad] from where it begins, that no servo leads a joint without end
_BEYOND: Final = np.pi  # [rad] behind the end of a joint, where nobody leads it
_FAR: Final = 0.5  # [rad] from all commands of a joint, where few arms begin
_MORE: Final = 100.0  # times the torque that masses need, which no friction makes of it
# of the torque that a joint's own commands leave unexplained: below, it follows another's, or the
# opposite of its own; of this, a joint that counts the other way leaves 0.4 and more
_RATHER, _AGAINST = HALF, SOME


def check_commanded(simulation: Simulation, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Refuse recordings that say nothing of drives; tell what is odd about the others.

    Args:
        simulation: Of the arm; a joint without a drive is taken for one behind a usual servo.
        recordings: With commands.

    Returns:
        A sentence each: joints that stalled or moved without a command, delays that no joint has,
        rows that are missing.

    Raises:
        ConfigError: The simulation has an effect that cannot be run forward.
        RecordingError: There is none, one is of another robot or given twice, or its commands are
            no set-points of its joints in rad that came before the motion.
    """
    if not recordings:
        raise RecordingError("no recording with commands was given")
    for recording in recordings:
        recording.check_robot(simulation.model)
    check_different(recordings)
    given, commanded = with_servos(simulation, recordings)
    for recording in commanded:
        check_torques(given, recording)
    return (*check_commands(commanded, given.model.sliding), *check_timing(given, commanded))


def check_forward(simulation: Simulation, orders: Commanded) -> tuple[str, ...]:
    """Refuse commands from which no motion should be simulated; tell what is odd about the others.

    They are held against the motion that was recorded, by the same rules as where that is fitted
    to, but that they may rest. Nothing but the first position of it gets into the simulation.

    Args:
        simulation: With a drive for each joint.
        orders: The commands.

    Raises:
        RecordingError: They are of another robot, or no set-points of its joints in rad that came
            before the motion.
    """
    orders.check_robot(simulation.model)
    simulation = simulation.with_motors(orders.channels)
    orders = orders.led(simulation.channels)
    if orders.recorded is None:
        return check_alone(simulation.model, orders)
    orders.recorded.check_robot(simulation.model)
    check_torques(simulation, orders.recorded)
    odd = check_set_points([orders.recorded], simulation.model.sliding)
    return (*odd, *check_timing(simulation, [orders.recorded]))


def check_alone(model: RobotModel, orders: Commanded) -> tuple[str, ...]:
    """Refuse commands that lead joints far beyond their ends; tell what else is odd.

    Args:
        model: The robot.
        orders: Its commands.

    Returns:
        A sentence, if the arm begins where no command leads it.

    Raises:
        RecordingError: Commands are in another unit.
    """
    low, high = orders.command.min(axis=0), orders.command.max(axis=0)
    turning = np.array(model.turning)
    least = np.where(turning, orders.start - _TURNS, model.limits.position_min)
    most = np.where(turning, orders.start + _TURNS, model.limits.position_max)
    beyond = np.maximum(least - low, high - most)
    j = int(beyond.argmax())
    if beyond[j] > _BEYOND:
        unit = unit_of("rad", model.sliding, j)
        raise RecordingError(
            f"command_{j + 1} spans {low[j]:.3g} to {high[j]:.3g}, where joint {j + 1} of "
            f"{model.name} begins at {orders.start[j]:.3g} {unit} and is led from {least[j]:.3g} "
            f"to {most[j]:.3g} {unit} at most; expected set-points in {unit}; are the commands in "
            f"{'mm' if model.sliding[j] else 'degrees'}, or normalised, as -100 to 100?",
            path=orders.source or None,
        )
    away = np.maximum(low - orders.start, orders.start - high)
    j = int(away.argmax())
    if away[j] <= _FAR:
        return ()
    return (
        f"joint {j + 1} begins {away[j]:.2f} {unit_of('rad', model.sliding, j)} away from all "
        "of its commands; are these deltas, or in another unit?",
    )


def check_torques(simulation: Simulation, recording: Recording) -> None:
    """Refuse commands that are not the torques of their joints in N m.

    Args:
        simulation: With a drive for each joint.
        recording: With commands, of torque or not.

    Raises:
        RecordingError: Names what the commands seem to be.
    """
    moves = np.ptp(recording.position, axis=0) > MOVED
    joints = np.flatnonzero(commanded_by(TORQUE, recording.channels) & moves).tolist()
    if not joints:
        return
    motion, rows = recording.motion(bandwidth_for([recording])), rows_of(simulation)
    load = simulation.body.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
    gain = np.array([value_in(row, "gain") for row in rows])
    sliding = simulation.model.sliding
    mistake = (
        _column_mistake(recording, joints, sliding)
        or _unit_mistake(gain * commands_of(recording), load, joints, sliding)
        or _following_mistake(loaded_joints(simulation.body, [recording]), rows, joints)
    )
    if mistake:
        raise RecordingError(mistake, path=recording.source or None)


def _column_mistake(recording: Recording, joints: Sequence[int], sliding: Sequence[bool]) -> str:
    """Say what else the columns of joints that move seem to hold."""
    command, position = commands_of(recording), recording.position
    for j in joints:
        if not command[:, j].any():
            return (
                f"{TORQUE.name}_{j + 1} is always 0 while joint {j + 1} moves; expected the torque "
                "in force at each row; was the arm led by hand, or its torque disabled?"
            )
    away = np.sqrt(np.mean((command - position) ** 2, axis=0))
    if (away < SOME * np.std(position, axis=0))[list(joints)].all():
        j = joints[0] + 1
        return (
            f"{TORQUE.name}_{j} is near position_{j} throughout; expected "
            f"{unit_of('N m', sliding, j - 1)}; are these set-points of positions, "
            f"{POSITION.name}_{j}?"
        )
    return ""


def _unit_mistake(
    torque: FloatArray, load: FloatArray, joints: Sequence[int], sliding: Sequence[bool]
) -> str:
    """Say which unit commands seem to have, if what drives make of them moves no such arm.

    Args:
        torque: That drives would make of them, (T, n) [N m].
        load: That the masses of the arm need, (T, n) [N m].
        joints: That move, 0-based.
        sliding: Which joints slide, (n,).
    """
    size, needed = (np.sqrt(np.mean(x[:, list(joints)] ** 2, axis=0)) for x in (torque, load))
    ratio = size / np.maximum(needed, TINY)
    usual = float(np.median(ratio))
    if LITTLE < usual < _MORE:
        return ""
    what = (
        "in N mm or mA"
        if usual > 1.0
        else "normalised, currents, or torques of motors before their gears, whose drives state no "
        "`gain`"
    )
    return (
        f"{TORQUE.name} would be {usual:.3g} times the torque that the masses of the arm need; "
        f"expected {unit_of('N m', sliding)}; are the commands {what}?"
    )


def _following_mistake(
    parts: Sequence[Sequence[LoadedJoint]], rows: FloatArray, joints: Sequence[int]
) -> str:
    """Say whose torque a joint follows, or that it follows its own the other way.

    What each joint needs is known of the motion; torques of its own column have to explain it
    better than those of another, with which they are exchanged, or than their opposite. A joint
    that counts against the description, position and torque alike, needs neither.

    Args:
        parts: Recorded stretches of each joint.
        rows: The constants of each.
        joints: That are told torques and move, 0-based.
    """

    def left(j: int, k: int, sign: float = 1.0) -> float:
        """Return the torque of a joint that commands of a column leave unexplained [N m]."""
        columns = zip(parts[j], parts[k], strict=True)
        orders = [replace(own, command=sign * other.command) for own, other in columns]
        return min(regressed(orders, rows[j], delay)[0] for delay in DELAYS)

    known = {j: own for j in joints if 0.0 < (own := left(j, j)) < np.inf}
    ratio = {(j, k): left(j, k) / known[j] for j, k in permutations(known, 2)}
    mutual = {(j, k): own for (j, k), own in ratio.items() if own < _RATHER and ratio[k, j] < 1.0}
    if mutual:
        j, k = min(mutual, key=lambda pair: mutual[pair])
        return (
            f"joint {j + 1} moves as {TORQUE.name}_{k + 1} says, not {TORQUE.name}_{j + 1}; are "
            "joints exchanged?"
        )
    for j, own in known.items():
        if left(j, j, -1.0) < _AGAINST * own:
            return (
                f"joint {j + 1} moves against {TORQUE.name}_{j + 1}; has one of them the other "
                "sign?"
            )
    return ""
