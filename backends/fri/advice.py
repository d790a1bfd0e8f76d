"""Advice for a session that does not get as far as taking commands, in plain words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from backends.fri.codec.messages import (
    CommandMode,
    DriveState,
    OperationMode,
    Quality,
    SafetyState,
    SessionState,
)

if TYPE_CHECKING:
    from backends.fri.codec.messages import Monitoring

LONGEST_COMMANDING: Final = 10  # [ms] between answers
LONGEST_FORCE_CONTROL: Final = 5  # [ms], where torques or wrenches are commanded

_ADVICE: Final = {
    SessionState.IDLE: "no FRI session is open: start the robot application that opens one",
    SessionState.MONITORING_WAIT: (
        "the controller does not find the connection good enough: answers come late or not at all; "
        "check the cable, the switch and what else this machine computes"
    ),
    SessionState.MONITORING_READY: (
        "the robot application opened the session but commands no overlay yet: "
        "start the motion with the FRI joint overlay"
    ),
    SessionState.COMMANDING_WAIT: (
        "the controller waits for the motion to begin: enable the drives, press the start key, "
        "and let the client answer with the positions it is sent"
    ),
    SessionState.COMMANDING_ACTIVE: "the session takes commands",
}


def advice(message: Monitoring) -> list[str]:
    """Return what keeps a session from taking commands, the most likely first."""
    robot, connection = message.robot, message.connection
    said = [text for text in (safety_stop(message), drives_off(message)) if text]
    if robot is not None and robot.operation_mode in {OperationMode.T1, OperationMode.T2}:
        mode = OperationMode(robot.operation_mode).name
        said.append(
            f"the cell is in {mode}: the motion stops when the enabling switch or the start "
            "key is let go"
        )
    if connection is None:
        return [*said, "the robot does not say how the session stands"]
    said += [text for text in (low_quality(message), long_period(message)) if text]
    if connection.session_state is not SessionState.COMMANDING_ACTIVE:
        said.append(_ADVICE[connection.session_state])
    return said


def why_not_ready(message: Monitoring | None, waited: float, malformed: str) -> str:
    """Say why a session took no commands, and what to do about it.

    Args:
        message: The robot's last one; None if it is silent.
        waited: How long was waited [s].
        malformed: What was wrong with the last datagram that could not be used, or who sent it.
    """
    if message is None or message.connection is None:
        why = f": {malformed}" if malformed else ""
        return f"the robot sent nothing usable any more when {waited:g} s were over{why}"
    state = message.connection.session_state
    reasons = "; ".join(advice(message)[:3])
    return f"the session is still in {state.name} after {waited:g} s: {reasons}"


def why_not_commanded(message: Monitoring) -> str:
    """Say what does not go with commands, whatever state the session is in; empty for nothing."""
    return safety_stop(message) or drives_off(message) or low_quality(message)


def low_quality(message: Monitoring) -> str:
    """Say that the connection is too bad to command; empty if it is not."""
    connection = message.connection
    if connection is None or connection.quality >= Quality.GOOD:
        return ""
    return (
        f"the connection is {connection.quality.name}; commanding needs GOOD: answer every packet "
        "within its period, on a cable of its own"
    )


def safety_stop(message: Monitoring) -> str:
    """Say which safety stop is in force; empty for none."""
    state = None if message.robot is None else message.robot.safety_state
    if state in {None, SafetyState.NORMAL}:
        return ""
    stop = SafetyState(state or 0).name.replace("_", " ")
    return f"a safety stop is in force ({stop}): acknowledge it on the smartPAD"


def drives_off(message: Monitoring) -> str:
    """Say which drives are not active; empty for none."""
    states = () if message.robot is None else message.robot.drive_states
    off = [str(j) for j, state in enumerate(states, 1) if state != DriveState.ACTIVE]
    if not off:
        return ""
    return (
        f"the drives of joints {', '.join(off)} are not active: hold the enabling switch in T1 or "
        "T2, or start the program in AUT"
    )


def long_period(message: Monitoring) -> str:
    """Say that a session of this period cannot be commanded; empty if it can."""
    connection, ipo = message.connection, message.ipo
    if connection is None or connection.send_period is None:
        return ""
    between = connection.send_period * max(connection.receive_multiplier or 1, 1)
    mode = None if ipo is None else ipo.command_mode
    most = LONGEST_COMMANDING
    if mode in {CommandMode.WRENCH, CommandMode.TORQUE}:
        most = LONGEST_FORCE_CONTROL
    if between <= most:
        return ""
    return (
        f"answers are {between} ms apart (send period x receive multiplier), and commanding needs "
        f"at most {most} ms: shorten the send period in the robot application"
    )
