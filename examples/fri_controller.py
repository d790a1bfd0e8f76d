"""An FRI controller and an FRI client, two processes, one arm: no robot needed.

    python examples/fri_controller.py          # half a minute

`limo controller` is the robot: an iiwa in MuJoCo behind FRI 1.15, on whose second joint somebody
leans for a second, and whose network loses a packet now and then. `limo run --backend fri` is the
client, as it would be for a real arm; it is begun when the controller says that it is ready. From
both come OUT/fri_controller.png and the lines that are
printed.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from limo_driver.recordings.recording import Recording
from limo_driver.trajectory import Trajectory

OUT = Path("out")
LIMO = [sys.executable, "-c", "from limo_driver.cli import main; main()"]
PORT = 30205
START = np.array([0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0])  # [rad], where the controller's arm stands
SWING = np.array([0.15, 0.1, 0.1, 0.15, 0.2, 0.15, 0.3])  # [rad]
SECONDS = 8.0
PUSH_AT, PUSH = 5.0, 15.0  # [s] since commanding began, [N m]
SCENARIO = f"""seed: 1
from: commanding
events:
  - {{event: push, at: {PUSH_AT}, for: 1.0, joint: 2, torque: {PUSH}}}
  - {{event: loss, at: 2.0, for: 2.0, fraction: 0.01}}
"""


def swing() -> Trajectory:
    """Return a motion that swings every joint to and fro twice, from rest to rest."""
    time = np.arange(0.0, SECONDS + 0.005, 0.01)
    rate = 4.0 * np.pi / SECONDS
    phase = rate * time[:, None]
    return Trajectory(
        time,
        START + 0.5 * SWING * (1.0 - np.cos(phase)),
        0.5 * SWING * rate * np.sin(phase),
        0.5 * SWING * rate**2 * np.cos(phase),
        robot="iiwa14",
    )


def play() -> dict:
    """Run both processes; return what the controller says at its end."""
    trajectory, scenario = OUT / "swing.traj.parquet", OUT / "scenario.yaml"
    swing().save(trajectory)
    scenario.write_text(SCENARIO, encoding="utf-8")
    controller = f"controller --client 127.0.0.1:{PORT} --period-ms 5 --scenario {scenario} --json"
    client = (
        f"run --backend fri --port {PORT} --trajectory {trajectory} --record {OUT}/swing.parquet"
    )
    print(f"$ limo {controller} &", flush=True)
    with subprocess.Popen([*LIMO, *controller.split()], stdout=subprocess.PIPE, text=True) as robot:
        try:
            if not robot.stdout.readline():
                sys.exit("the controller did not start")
            print(f"$ limo {client}", flush=True)
            subprocess.run([*LIMO, *client.split()], check=True)
        finally:
            robot.send_signal(signal.SIGINT)
        # `communicate` would not see what was read from the pipe with the first line
        return json.loads(robot.stdout.read().splitlines()[-1])


def draw(recording: Recording) -> None:
    """Plot what the client recorded, and when somebody leaned on the arm."""
    time = recording.time - recording.time[0]
    figure, (motion, torque) = plt.subplots(2, 1, figsize=(8, 6), sharex=True)
    joints = [str(joint) for joint in range(1, recording.position.shape[1] + 1)]
    motion.plot(time, recording.position, label=joints)
    motion.set_ylabel("measured position [rad]")
    motion.legend(title="joint", ncols=len(joints), fontsize="small", loc="lower center")
    motion.margins(y=0.35)
    torque.plot(time, recording.torque[:, 1], color="C1")
    torque.axvspan(PUSH_AT, PUSH_AT + 1.0, alpha=0.2, label="somebody leans on it")
    torque.set(xlabel="time since commanding began [s]", ylabel="torque of joint 2 [N m]")
    torque.legend()
    figure.suptitle("Recorded through FRI from a controller without a robot")
    figure.tight_layout()
    figure.savefig(OUT / "fri_controller.png", dpi=120)


def main() -> None:
    """Play, draw, and say how it went."""
    OUT.mkdir(exist_ok=True)
    report = play()
    draw(Recording.load(OUT / "swing.parquet"))
    packets = report["packets"]
    print("\nthe controller saw:")
    print("  " + " > ".join(visit["state"] for visit in report["states"]))
    print(f"  {packets['sent']} packets, {packets['answered']} answers, {packets['late']} late; "
          f"the network lost {report['scenario']['to_client']['lost']} and "
          f"{report['scenario']['to_robot']['lost']}")  # fmt: skip
    print(f"  quality {report['quality']['last']}, {len(report['stops'])} stops")
    print(f"\nwrote {OUT}/fri_controller.png")


if __name__ == "__main__":
    main()
