"""Play the commands of `limo excite --for position-servo`, and record what the encoders read.

    python examples/play_servos.py moves.csv --port /dev/ttyACM0 --out run.csv

sends each row at its time through LeRobot (`pip install lerobot[feetech]`), which counts in degrees
here, and leads the arm slowly to the first pose before. Another program does as well: `play` needs
two functions, one that sends goal positions [rad] and one that reads where the joints are.
"""

import argparse
import time as clock
from collections.abc import Callable

import numpy as np

APPROACH = 4.0  # [s] to the first pose


def play(
    commands: np.ndarray,
    send: Callable[[np.ndarray], object],
    read: Callable[[], np.ndarray],
    now: Callable[[], float] = clock.perf_counter,
    sleep: Callable[[float], object] = clock.sleep,
) -> np.ndarray:
    """Send rows of time [s] and goal positions [rad] at their times.

    Args:
        commands: (T, 1 + n), time and command_j.
        send: Takes goal positions, (n,) [rad].
        read: Returns positions, (n,) [rad].
        now: Seconds.
        sleep: Takes seconds.

    Returns:
        Rows of time, command_j and position_j, (T, 1 + 2 n): the goal in force at each reading.
    """
    first, start = commands[0, 1:], np.array(read())
    begun = now()
    while (s := min((now() - begun) / APPROACH, 1.0)) < 1.0:
        send(start + (3 - 2 * s) * s**2 * (first - start))
        sleep(0.02)
    send(first)
    rows, goal, begun = [], first, now()
    for due, *wanted in commands:
        sleep(max(due - (now() - begun), 0.0))
        rows.append([now() - begun, *goal, *read()])  # before the next goal is sent
        goal = np.array(wanted)
        send(goal)
    return np.array(rows)


def save(rows: np.ndarray, path: str) -> None:
    """Write what `play` returns as a recording that every command of limo takes."""
    n = rows.shape[1] // 2
    names = [f"{kind}_{j + 1}" for kind in ("command", "position") for j in range(n)]
    np.savetxt(
        path, rows, delimiter=",", header=",".join(["time", *names]), comments="", fmt="%.8f"
    )


def main() -> None:
    """Play a CSV on an arm of LeRobot's."""
    from lerobot.robots.so101_follower import SO101Follower, SO101FollowerConfig

    given = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    given.add_argument("commands")
    given.add_argument("--port", required=True)
    given.add_argument("--id", default="limo", help="of the arm's calibration")
    given.add_argument(
        "--motors", default="shoulder_pan,shoulder_lift,elbow_flex,wrist_flex,wrist_roll"
    )
    given.add_argument("--out", required=True)
    asked = given.parse_args()
    motors = [f"{name}.pos" for name in asked.motors.split(",")]
    robot = SO101Follower(SO101FollowerConfig(port=asked.port, id=asked.id, use_degrees=True))
    robot.connect()
    try:
        rows = play(
            np.loadtxt(asked.commands, delimiter=",", skiprows=1),
            lambda goal: robot.send_action(dict(zip(motors, np.degrees(goal), strict=True))),
            lambda: np.radians([robot.get_observation()[name] for name in motors]),
        )
    finally:
        robot.disconnect()
    save(rows, asked.out)


if __name__ == "__main__":
    main()
