"""What only the contract itself shows; how robots keep it is in tests/contract."""

import subprocess
import sys

WARM = """
import numpy as np

from limo_driver.robot import setpoints
from limo_driver.model import RobotModel
from limo_driver.robot.safety import SafetyContract, warm_up
from limo_driver.types import (
    ImpedanceCommand, JointState, PositionCommand, RobotSpec, TorqueCommand, WrenchCommand,
    WrenchLimits,
)

model, zero = RobotModel.load("iiwa14"), np.zeros(7)
wrench = WrenchLimits(wrench=np.ones(6), rate=np.ones(6))
spec = RobotSpec(model.name, model.joint_names, model.limits, 1e-3, wrench)
compiled = [f for f in vars(setpoints).values() if hasattr(f, "signatures")]
count = lambda: sum(len(f.signatures) for f in compiled)
assert count() == 0
warm_up(spec)
warm = count()

position, torque = PositionCommand(position=zero), TorqueCommand(torque=zero)
impedance = ImpedanceCommand(position=zero, stiffness=zero, damping=zero, torque=zero)
effort = WrenchCommand(wrench=np.zeros(6))
cycles = [position, impedance, torque, None, impedance, effort, position, "hold", position]
contract = SafetyContract(spec)
for cycle, command in enumerate(cycles):
    contract.observe(JointState(1e-3 * cycle, zero, zero, zero, cycle))
    if command == "hold":
        contract.hold("asked to")
        contract.stand_in()
        contract.resume()
        contract.lead(np.zeros(7))
    elif command is None:
        contract.stand_in()
    else:
        contract.admit(command)
    contract.restore(contract.save())
print(warm, count())
"""


def test_nothing_is_compiled_once_a_contract_was_warmed_up():
    done = subprocess.run([sys.executable, "-c", WARM], capture_output=True, text=True, check=True)
    warm, after = map(int, done.stdout.split())
    assert warm > 0
    assert after == warm
