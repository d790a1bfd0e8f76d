"""Move a simulated arm, creep through a reversal, and see what happens when commands stop."""

from pathlib import Path

import numpy as np

from limo_driver import LimoError, PositionCommand, open_robot

SIMULATION = Path(__file__).parent / "iiwa14_hysteretic.yaml"

with open_robot("mujoco", simulation=SIMULATION) as robot:
    state = robot.receive()
    start, torque = state.position, []
    for k in range(2000):  # 2 s at 1 kHz: out by 0.6° and back
        creep = 0.005 * (1 - np.cos(np.pi * k / 1000))
        robot.send(PositionCommand(position=start + creep))
        state = robot.receive()
        torque.append(state.torque)
    there, back = torque[500], torque[1500]  # the same position, in both directions
    print("torque there and back [N m]:", np.round(there, 2), np.round(back, 2))

    while not state.holding:  # no more commands: the last one expires, and the arm holds
        state = robot.receive()
    try:
        robot.send(PositionCommand(position=start))
    except LimoError as error:
        print("refused:", error)
    robot.resume()
    robot.send(PositionCommand(position=robot.receive().position))
    print("resumed from the measured pose")
