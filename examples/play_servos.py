"""Play the commands of `limo excite --for position-servo`, and record what the encoders read.

    python examples/play_servos.py moves.csv --simulate so101.xml --out rehearsal.csv
    python examples/play_servos.py moves.csv --port /dev/ttyACM0 --out run.csv

The first plays them on a simulated arm, by the position actuators of an MJCF file. The second sends
each row at its time through LeRobot (`pip install lerobot[feetech]`), which counts in degrees here,
but the gripper in percent of its range. Both lead the arm slowly to the first pose before. Another
program does as well: `play` needs two functions, one that sends goal positions [rad] and one that
reads where the joints are.
"""

import argparse
import time as clock
from collections.abc import Callable

import numpy as np

APPROACH = 4.0  # [s] to the first pose
TICK = 2 * np.pi / 4096  # [rad], of the encoder of a simulated servo
GRIPPER = (-0.174533, 1.74533)  # [rad], 0 and 100 % of the SO-101's, as its description has them


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
        Rows of time, command_j and position_j, (T, 1 + 2 n): each goal beside the positions at
        which it was sent.
    """
    first, start = commands[0, 1:], np.array(read())
    begun = now()
    while (s := min((now() - begun) / APPROACH, 1.0)) < 1.0:
        send(start + (3 - 2 * s) * s**2 * (first - start))
        sleep(0.02)
    send(first)
    rows, begun = [], now()
    for due, *goal in commands:
        sleep(max(due - (now() - begun), 0.0))
        rows.append([now() - begun, *goal, *read()])
        send(np.array(goal))  # in force from this row on
    return np.array(rows)


def save(rows: np.ndarray, path: str) -> None:
    """Write what `play` returns as a recording that every command of limo takes."""
    n = rows.shape[1] // 2
    names = [f"{kind}_{j + 1}" for kind in ("command", "position") for j in range(n)]
    np.savetxt(
        path, rows, delimiter=",", header=",".join(["time", *names]), comments="", fmt="%.8f"
    )


def counted(name: str, goal: float) -> float:
    """Return a goal [rad] as LeRobot counts it: in degrees, a gripper in percent."""
    low, high = GRIPPER
    return 100 * (goal - low) / (high - low) if name == "gripper" else float(np.degrees(goal))


def in_rad(name: str, told: float) -> float:
    """Return in rad what LeRobot tells of a motor."""
    low, high = GRIPPER
    return low + told / 100 * (high - low) if name == "gripper" else float(np.radians(told))


class SimulatedArm:
    """The arm of an MJCF file, moved by its own position actuators."""

    def __init__(self, path: str) -> None:
        import mujoco

        self.step, self.model = mujoco.mj_step, mujoco.MjModel.from_xml_path(path)
        self.data = mujoco.MjData(self.model)
        moved = self.model.actuator_trnid[:, 0]
        self.order = np.argsort(moved)  # actuators, as joints are counted
        self.place = self.model.jnt_qposadr[moved[self.order]]

    def send(self, goal: np.ndarray) -> None:
        """Set goal positions, (n,) [rad]."""
        self.data.ctrl[self.order] = goal

    def read(self) -> np.ndarray:
        """Return where the joints are by their encoders, (n,) [rad]."""
        return TICK * np.round(self.data.qpos[self.place] / TICK)

    def now(self) -> float:
        """Return the simulated time [s]."""
        return self.data.time

    def sleep(self, seconds: float) -> None:
        """Simulate some time."""
        until = self.data.time + seconds - self.model.opt.timestep / 2
        while self.data.time < until:
            self.step(self.model, self.data)


def main() -> None:
    """Play a CSV on an arm of LeRobot's, or on a simulated one."""
    given = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    given.add_argument("commands")
    where = given.add_mutually_exclusive_group(required=True)
    where.add_argument("--port", help="of a real arm")
    where.add_argument("--simulate", metavar="MJCF", help="whose actuators move the arm instead")
    given.add_argument("--id", default="limo", help="of the arm's calibration")
    given.add_argument(
        "--motors", default="shoulder_pan,shoulder_lift,elbow_flex,wrist_flex,wrist_roll,gripper"
    )
    given.add_argument("--out", required=True)
    asked = given.parse_args()
    commands = np.loadtxt(asked.commands, delimiter=",", skiprows=1)
    if asked.simulate:
        arm = SimulatedArm(asked.simulate)
        save(play(commands, arm.send, arm.read, arm.now, arm.sleep), asked.out)
        return
    names = asked.motors.split(",")
    if len(names) != commands.shape[1] - 1:
        given.error(f"--motors names {len(names)}; {asked.commands} moves {commands.shape[1] - 1}")
    from lerobot.robots.so101_follower import SO101Follower, SO101FollowerConfig

    robot = SO101Follower(SO101FollowerConfig(port=asked.port, id=asked.id, use_degrees=True))
    robot.connect()

    def told(seen: dict[str, float]) -> np.ndarray:
        return np.array([in_rad(name, seen[f"{name}.pos"]) for name in names])

    try:
        rows = play(
            commands,
            lambda goal: robot.send_action(
                {f"{n}.pos": counted(n, x) for n, x in zip(names, goal, strict=True)}
            ),
            lambda: told(robot.get_observation()),
        )
    finally:
        robot.disconnect()
    save(rows, asked.out)


if __name__ == "__main__":
    main()
