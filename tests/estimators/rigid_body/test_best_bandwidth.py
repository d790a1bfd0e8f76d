"""The bandwidth that is chosen: of fast motion a wide one, of noisy encoders a narrow one."""

import numpy as np
import pytest

import limo_driver as limo
from estimators.rigid_body.best_bandwidth import choose_bandwidth
from limo_driver.errors import RecordingError
from limo_driver.physics import CoulombFriction, Simulation, ViscousFriction

RATE = 500.0


@pytest.fixture(scope="module")
def arm(two_links_urdf):
    effects = [CoulombFriction(joint=j, tau_c=0.3) for j in (1, 2)]
    return Simulation(str(two_links_urdf), (*effects, ViscousFriction(joint=1, f_v=0.2)))


def recorded(arm, frequency, amplitude, encoder=1e-6, torque=0.01, seconds=24.0, seed=0):
    """Record swings around a frequency [Hz], with noise of encoders [rad] and torques [N m]."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    slow = 0.4 * np.sin(np.outer(t, [1.1, 1.7]))
    swing = 2.0 * np.pi * frequency * np.outer(t, [1.0, 1.23])
    fast = amplitude * np.sin(swing + 0.3 * np.sin(0.7 * t)[:, None])
    motion = limo.Motion.from_positions(t, slow + fast)
    measured = arm.predict(motion) + torque * random.standard_normal(motion.position.shape)
    noisy = motion.position + encoder * random.standard_normal(motion.position.shape)
    return limo.Recording.from_arrays(t, noisy, measured)


def chosen(arm, *recordings):
    return choose_bandwidth(arm.model, recordings)


def test_is_the_usual_one_of_slow_motion_and_good_encoders(arm):
    found = chosen(arm, recorded(arm, 0.7, 0.05))
    assert found.bandwidth == 10.0
    assert found.scored_at == 100.0


def test_is_wide_where_motion_is_fast(arm):
    found = chosen(arm, recorded(arm, 25.0, 0.004))
    assert found.bandwidth >= 40.0
    assert found.errors[10.0] > 1.25
    assert "held out" in found.headline()


def test_is_narrow_where_encoders_are_noisy(arm):
    found = chosen(arm, recorded(arm, 0.5, 0.05, encoder=3e-3))
    assert found.bandwidth < 10.0
    assert found.errors[10.0] > 1.25


def test_is_that_of_all_recordings_together(arm):
    slow, fast = recorded(arm, 0.7, 0.05), recorded(arm, 25.0, 0.004, seed=1)
    assert chosen(arm, slow, fast).bandwidth >= 40.0


def test_is_not_chosen_without_torque(arm):
    silent = recorded(arm, 0.7, 0.05)
    silent = limo.Recording.from_arrays(silent.time, silent.position, command=silent.position)
    with pytest.raises(RecordingError):
        chosen(arm, silent)


class TestIdentification:
    def test_finds_it_says_so_and_keeps_it_in_the_simulation(self, arm, tmp_path):
        run = recorded(arm, 25.0, 0.004)
        found = limo.identify(arm.model, run)
        assert found.simulation.bandwidth == found.rows.bandwidth >= 40.0
        assert any("held out" in warning for warning in found.warnings)
        found.simulation.save(tmp_path / "sim.yaml")
        read = limo.Simulation.load(tmp_path / "sim.yaml")
        assert read.bandwidth == found.simulation.bandwidth
        assert read.score(run).bandwidth == found.simulation.bandwidth
        assert read.score(run, 10.0).bandwidth == 10.0
        assert limo.train(read, run).bandwidth == found.simulation.bandwidth
        assert limo.predict(read, run).torque == pytest.approx(
            limo.predict(read, run, bandwidth=read.bandwidth).torque
        )

    def test_at_the_usual_one_says_nothing_of_it(self, arm, tmp_path):
        found = limo.identify(arm.model, recorded(arm, 0.7, 0.05))
        assert found.simulation.bandwidth is None
        found.simulation.save(tmp_path / "sim.yaml")
        assert "bandwidth" not in (tmp_path / "sim.yaml").read_text()

    def test_of_slower_samples_is_at_what_they_bear(self, arm):
        run = recorded(arm, 0.7, 0.05)[::25]  # 20 Hz
        fast = limo.Simulation(arm.robot, arm.effects, bandwidth=40.0)
        assert fast.score(run).bandwidth == pytest.approx(7.2, abs=0.1)


@pytest.mark.parametrize("given", ["0", "-1", "fast", "[1]"])
def test_bandwidth_of_a_file_that_cannot_be_is_refused(tmp_path, given):
    (tmp_path / "sim.yaml").write_text(f"robot: iiwa14\nbandwidth: {given}\n")
    with pytest.raises(limo.LimoError, match="line 2: bandwidth is"):
        limo.Simulation.load(tmp_path / "sim.yaml")
