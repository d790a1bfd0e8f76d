"""Effects that are hidden in a recording of one's own have the size and the torque that is said."""

import json

import conceal_on_recording
import numpy as np
import pytest
from conceal_on_recording import EFFECTS, Concealer, Outcome, conceal

import limo_driver as limo
from limo_driver.physics import Payload, Simulation

TIME = np.arange(0, 12, 0.02)
BANDWIDTH = 5.0


@pytest.fixture(scope="module")
def simulation():
    return Simulation("iiwa14")


@pytest.fixture(scope="module")
def recording(simulation):
    rate = 2 * np.pi * (0.2 + 0.05 * np.arange(7))
    rate[6] = 0.0  # it does not move, and nothing is hidden there
    phase = np.outer(TIME, rate) + np.arange(7)
    motion = limo.Motion(TIME, np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase))
    noise = np.random.default_rng(3).normal(0.0, 0.5, phase.shape)
    torque = simulation.predict(motion) + noise
    return limo.Recording.from_arrays(TIME, motion.position, torque)


@pytest.fixture(scope="module")
def concealer(recording, simulation):
    return Concealer(recording, simulation, BANDWIDTH)


@pytest.mark.parametrize("effect", sorted({*EFFECTS} - {"external_contact"}))
def test_an_effect_is_as_large_as_the_error_says(concealer, effect):
    hidden = concealer.draw(effect, np.random.default_rng(1))
    times = np.sqrt(np.mean(hidden.torque**2, axis=0)) / concealer.error
    low, high = conceal_on_recording.SIZES
    assert low - 1e-9 <= times.max() <= 1.5 * high  # a delay is a whole number of samples
    if hidden.joint:
        assert np.flatnonzero(times).tolist() == [hidden.joint - 1]
        assert hidden.joint != 7


def test_a_push_spares_what_is_held_out(concealer):
    hidden = concealer.draw("external_contact", np.random.default_rng(1))
    cut = int(conceal_on_recording.DIAGNOSED * len(TIME))
    assert hidden.torque[:cut].any()
    assert not hidden.torque[cut:].any()


def test_a_point_mass_weighs_what_a_payload_does(concealer, simulation):
    mine = concealer._torque_of_point(np.array([0.02, -0.01, 0.1]))
    flange = simulation.model.flange_pose(np.zeros(7)) @ [0.02, -0.01, 0.1, 1.0]
    link = np.linalg.solve(simulation.model.joint_poses(np.zeros(7))[-1], flange)[:3]
    payload = Payload(mass=1.0, com=tuple(link.tolist()))
    loaded = Simulation("iiwa14", (payload,)).predict(concealer.motion)
    inner = slice(50, -50)  # where differences of velocities are those of the filter
    difference = (mine - (loaded - simulation.predict(concealer.motion)))[inner]
    assert np.abs(difference).max() < 0.01 * np.abs(loaded).max()


def test_a_case_says_what_is_true_and_what_it_costs(recording, simulation, concealer, tmp_path):
    hidden = concealer.draw("coulomb_friction", np.random.default_rng(0))
    conceal(recording, simulation, hidden, tmp_path)

    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    j = hidden.joint - 1
    assert truth["effects"][0]["joints"] == [hidden.joint]
    assert truth["rmse_before"][j] > 2 * truth["rmse_with_effect"][j]
    late = limo.Recording.load(tmp_path / "heldout.parquet")
    early = limo.Recording.load(tmp_path / "recording.parquet")
    assert len(early) + len(late) == len(recording)
    added = early.torque - recording.torque[: len(early)]
    assert added[:, j] == pytest.approx(hidden.torque[: len(early), j], abs=1e-6)


def test_names_count_at_their_joint_and_beside_what_was_there_anyhow():
    truth = {
        "effects": [{"effect": "coulomb_friction", "joints": [2]}],
        "accept_also": ["stribeck_friction"],
        "rmse_before": [1.0, 4.0],
        "rmse_with_effect": [1.0, 1.0],
    }
    names = (("stribeck_friction", (2,), ()), ("armature", (1,), ()), ("torque_ripple", (1,), ()))
    outcome = Outcome(truth, names, np.array([1.0, 1.1]), (), 1.0)
    assert outcome.named
    assert outcome.closed
    assert outcome.false([("torque_ripple", 1)]) == ["armature [1]"]
    elsewhere = Outcome(truth, (("coulomb_friction", (1,), ()),), np.array([1.0, 1.2]), (), 1.0)
    assert not elsewhere.named
    assert not elsewhere.closed
