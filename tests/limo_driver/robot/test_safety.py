"""What only the contract itself shows; how robots keep it is in tests/contract."""

import subprocess
import sys

import pytest
from contracts import PERIOD, moved, opened, reason, state

from limo_driver.errors import ConfigError, HoldingError

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


@pytest.mark.slow("compiles in a process of its own")
def test_nothing_is_compiled_once_a_contract_was_warmed_up():
    done = subprocess.run([sys.executable, "-c", WARM], capture_output=True, text=True, check=True)
    warm, after = map(int, done.stdout.split())
    assert warm > 0
    assert after == warm


def test_a_hold_is_not_lost_that_comes_while_a_command_is_taken():
    """By another thread, as from a button: between what was checked and what was noted."""
    holding = []
    contract = opened(check=lambda _: contract.hold("pressed") if holding else None)
    contract.admit(moved())
    contract.observe(state(1))
    holding.append(True)
    with pytest.raises(HoldingError, match="pressed"):
        contract.admit(moved(valid_for=10 * PERIOD))
    contract.observe(state(2))
    assert "pressed" in reason(contract)
    holding.clear()
    contract.resume()
    contract.admit(moved())
    assert not contract.holding


@pytest.mark.parametrize("given", ["x", None, float("nan"), 0, -1.0, float("inf")])
def test_a_validity_that_is_none_is_refused(given):
    with pytest.raises(ConfigError, match=f"valid_for = {given} s"):
        opened().admit(moved(valid_for=given))
