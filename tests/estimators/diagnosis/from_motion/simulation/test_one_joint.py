"""Stretches of a joint, simulated as one."""

from __future__ import annotations

import numpy as np
from servo_arms import commands, recorded, simulated, write_arm

from estimators.diagnosis.from_motion.simulation.loads import loaded_joints
from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from limo_driver.physics import Simulation


def test_joined_stretches_move_as_each_of_them_does(tmp_path):
    path = write_arm(tmp_path / "arm.xml")
    simulation = Simulation.load(path)
    time, command = commands(4.0, 100.0)
    recording = recorded(time, command, simulated(path, time, command))
    ((whole,), _) = loaded_joints(simulation.body, [recording])
    row = rows_of(simulation)[0]
    parts = [whole.between(150, 300), whole.between(0, 150), whole.between(20, 400)]

    each = np.concatenate([part.simulate(row) for part in parts])
    joined = LoadedJoint.joined([LoadedJoint.joined(parts[:2]), parts[2]])

    np.testing.assert_array_equal(joined.simulate(row), each)
    np.testing.assert_array_equal(joined.begins, [0, 150, 300])
    # as in one stretch it would not: each begins anew where the recorded joint was
    run_on = LoadedJoint(*(getattr(joined, name) for name in LoadedJoint.__match_args__))
    assert np.abs(run_on.simulate(row) - each).max() > 0.01
