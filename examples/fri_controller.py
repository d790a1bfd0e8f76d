"""An FRI controller and an FRI client, two processes, one arm: no robot needed.

    python examples/fri_controller.py          # half a minute

The controller, as `limo controller` has it, is the robot: an iiwa in MuJoCo behind FRI 1.15, on
whose second joint somebody leans for a second, and whose network loses a packet now and then. The
backend `fri` is the client, as it would be for a real arm; it is opened when the controller says
that it is ready. From both come OUT/fri_controller.png and the lines that are printed.
"""

from __future__ import annotations

import multiprocessing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import limo_driver as limo
from backends.fri.simulator.connection.port import Address
from backends.fri.simulator.controller import SimulatedController
from backends.fri.simulator.scenario import ControllerScenario
from backends.fri.simulator.session import ControllerSettings
from limo_driver.robot.interrupts import interrupts

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

OUT = Path("out")
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


def swing() -> limo.Trajectory:
    """Return a motion that swings every joint to and fro twice, from rest to rest."""
    time = np.arange(0.0, SECONDS + 0.005, 0.01)
    rate = 4.0 * np.pi / SECONDS
    phase = rate * time[:, None]
    return limo.Trajectory(
        time,
        START + 0.5 * SWING * (1.0 - np.cos(phase)),
        0.5 * SWING * rate * np.sin(phase),
        0.5 * SWING * rate**2 * np.cos(phase),
        robot="iiwa14",
    )


def control(scenario: Path, told: Connection) -> None:
    """Be the controller until SIGTERM; say when it is ready, and at the end how it went."""
    settings = ControllerSettings(client=Address("127.0.0.1", PORT), period_ms=5)
    with (
        SimulatedController(settings, None, ControllerScenario.load(scenario)) as controller,
        interrupts(controller.stop),
    ):
        told.send("ready")
        report = controller.run()
    told.send(report.as_json())


def play() -> tuple[dict[str, Any], limo.Recording]:
    """Run both processes; return what the controller says at its end, and the recording."""
    scenario = OUT / "scenario.yaml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    start = multiprocessing.get_context("spawn")
    heard, told = start.Pipe(duplex=False)
    robot = start.Process(target=control, args=(scenario, told))
    robot.start()
    told.close()  # the controller alone has it now, so that its end is noticed
    try:
        heard.recv()
        recording = limo.run("fri", swing(), link={"port": PORT}, record=OUT / "swing.parquet")
    finally:
        robot.terminate()  # SIGTERM, which ends its session in order
    report = heard.recv()
    robot.join()
    return report, recording


def draw(recording: limo.Recording) -> None:
    """Plot what the client recorded, and when somebody leaned on the arm."""
    import matplotlib.pyplot as plt  # which the process of the controller has no use for

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
    report, recording = play()
    draw(recording)
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
