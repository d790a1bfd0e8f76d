"""The plant obeys mechanics, and owes nothing to the catalogue that is measured on it."""

from pathlib import Path

import arm as arm_
import drive as drive_
import numpy as np
import pinocchio as pin
import presliding
import pytest
from arm import N
from plant import PERIOD, Control, Reference, simulate

NOTHING = np.zeros(N)


@pytest.fixture(scope="module")
def arm():
    return arm_.load()[0]


def drop(arm, drive, start, seconds, wrench=None):
    """Let the arm fall from rest, with nobody at the controls."""
    rows = int(seconds / PERIOD)
    still = np.zeros((rows, N))
    reference = Reference(np.tile(start, (rows, 1)), still, still, still)
    wrench = np.zeros((rows, 6)) if wrench is None else wrench
    return simulate(arm, drive, Control(NOTHING, NOTHING, NOTHING), reference, wrench)


def energy(arm, response):
    """Return kinetic and potential energy, (T, 2) [J]."""
    w, M, value = arm_.work(), np.zeros((N, N)), []
    for q, v in zip(response.link, response.velocity, strict=True):
        arm_.place(arm, q, w)
        arm_.mass_matrix(arm, w, M)
        value.append((0.5 * v @ M @ v, -arm.mass @ w.centre @ arm.gravity))
    return np.array(value)


@pytest.mark.slow("compiles the plant, which no change of limo touches")
def test_dynamics_are_those_of_pinocchio(arm):
    model = pin.buildModelFromUrdf(str(arm_.URDF))
    data, random = model.createData(), np.random.default_rng(0)
    q, v, a = random.normal(size=(3, 20, N))
    torque = arm_.along(arm, arm_.work(), q, v, a)
    expected = [pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)]
    np.testing.assert_allclose(torque, expected, atol=1e-10)
    w, M = arm_.work(), np.zeros((N, N))
    arm_.place(arm, q[0], w)
    arm_.mass_matrix(arm, w, M)
    upper = np.triu(pin.crba(model, data, q[0]))
    np.testing.assert_allclose(M, upper + np.triu(upper, 1).T, atol=1e-12)


@pytest.mark.slow("compiles the plant, which no change of limo touches")
def test_a_push_at_the_flange_is_carried_by_its_jacobian(arm):
    model = pin.buildModelFromUrdf(str(arm_.URDF))
    data, q = model.createData(), np.linspace(-1, 1, N)
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    frame = model.getFrameId("flange")
    J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    w, wrench = arm_.work(), np.array([3.0, -2.0, 5.0, 0.3, 0.2, -0.1])
    free, pushed = np.zeros(N), np.zeros(N)
    arm_.place(arm, q, w)
    arm_.inverse_dynamics(arm, NOTHING, NOTHING, np.zeros(6), w, free)
    arm_.inverse_dynamics(arm, NOTHING, NOTHING, wrench, w, pushed)
    np.testing.assert_allclose(pushed - free, -J.T @ wrench, atol=1e-12)


@pytest.mark.slow("compiles the plant, which no change of limo touches")
def test_a_falling_arm_keeps_its_energy_and_friction_takes_it(arm):
    start = np.array([0.3, 1.2, -0.4, 0.9, 0.2, 0.5, 0.1])
    free = drop(arm, drive_.plain(NOTHING, NOTHING, NOTHING, 1e-3), start, 0.4)
    kept = energy(arm, free)
    # The step is of first order; what is recorded does not depend on it, see the next test.
    assert np.ptp(kept.sum(axis=1)) < 0.02 * np.ptp(kept[:, 0])
    dry = drop(arm, drive_.plain(NOTHING, np.full(N, 1.0), np.ones(N), 1e-3), start, 0.4)
    lost = np.diff(energy(arm, dry).sum(axis=1))
    assert lost.sum() < -1.0
    assert lost.max() < 1e-3


@pytest.mark.slow("compiles the plant, which no change of limo touches")
def test_what_is_recorded_is_inverse_dynamics_and_friction(arm):
    drive = drive_.plain(np.ones(N), np.full(N, 1.0), np.full(N, 2.0), 1e-3)
    response = drop(arm, drive, np.full(N, 0.4), 0.5)
    rigid = arm_.along(
        arm, arm_.work(), response.position, response.velocity, response.acceleration
    )
    v = response.velocity
    friction = v * drive_.slope(v, 1e-3) + 2.0 * v
    np.testing.assert_allclose(response.torque, rigid + friction, atol=1e-9)


@pytest.mark.slow("compiles the plant, which no change of limo touches")
def test_a_gear_bends_by_its_load_and_a_play_by_half_its_gap(arm):
    rows = 3000
    still, pose = np.zeros((rows, N)), np.full(N, 0.5)
    reference = Reference(
        np.tile(pose, (rows, 1)), still, still,
        arm_.along(arm, arm_.work(), np.tile(pose, (rows, 1)), still, still),
    )  # fmt: skip
    control = Control(np.full(N, 2e3), np.full(N, 2e2), NOTHING)
    plain = drive_.plain(np.ones(N), NOTHING, NOTHING, 1e-3)
    for values, expected in (
        ({"stiffness": 5e3}, lambda load: load / 5e3),
        ({"stiffness": 1e6, "gap": 0.01}, lambda load: 0.005 * np.sign(load)),
    ):
        drive = drive_.changed(plain, 1, **values)
        response = simulate(arm, drive, control, reference, np.zeros((rows, 6)))
        bend = response.position[-1, 1] - response.link[-1, 1]
        assert bend == pytest.approx(expected(response.torque[-1, 1]), rel=0.05)


@pytest.mark.slow("simulates the plant, which no change of limo touches")
@pytest.mark.parametrize("law", presliding.LAWS)
def test_presliding_saturates_forgets_speed_and_dissipates(law):
    drive = drive_.plain(np.ones(N), NOTHING, NOTHING, 1e-3)
    drive = drive_.changed(drive, 0, **presliding.draw(law, 1.0, 5e-3, np.random.default_rng(1)))
    path = 0.03 * np.sin(np.linspace(0, 4 * np.pi, 4001))

    def along(speed):
        memory, torque = drive_.rested(), []
        for dq in np.diff(path):
            presliding.advance(drive[0], dq, np.sign(dq) * speed, memory[0])
            torque.append(presliding.torque(drive[0], memory[0]))
        return np.array(torque)

    slow, fast = along(0.1), along(1.0)
    np.testing.assert_allclose(slow, fast, atol=1e-6)
    assert 0.9 < np.abs(slow).max() < 1.05
    loop = slow[2000:] @ np.diff(path)[2000:]
    assert 0.03 < loop < 4 * 0.03 * 1.05


def test_it_shares_no_code_with_the_catalogue():
    for module in Path(arm_.__file__).parent.glob("*.py"):
        if not module.name.startswith("test_"):
            text = module.read_text()
            assert "physics" not in text, module.name
            assert "estimators" not in text, module.name
            assert "backends" not in text, module.name
