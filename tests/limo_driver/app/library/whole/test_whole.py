"""All of limo as one piece, over each wire: real processes, one of them killed in the middle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from one_file import check_page, title_of

from backends.can.config import ArmConfig
from limo_driver.app.library.whole import plant
from limo_driver.app.library.whole.explaining import BANDWIDTH, judge_explanation, whole_page
from limo_driver.app.library.whole.processes import BACKENDS, RATE, wire_of
from limo_driver.app.library.whole.proving import Proof, Step, prove
from limo_driver.errors import ConfigError
from limo_driver.physics import CoulombFriction, Payload
from limo_driver.recordings.recording import Recording

STEPS = 11

pytestmark = pytest.mark.waits


@pytest.mark.slow("goes the whole way in real time, four minutes for each wire")
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_whole_holds(backend: str, tmp_path: Path) -> None:
    proof = prove(tmp_path, backend)
    assert not proof.failure, (proof.failure, proof.steps)
    assert [step for step in proof.steps if not step.held] == []
    assert len(proof.steps) == STEPS


def test_nothing_that_is_concealed_is_believed() -> None:
    believed, true = plant.believed(), plant.true_arm()
    worn = plant.WORN
    extra = plant.friction_of(true, worn.joint) - plant.friction_of(believed, worn.joint)
    assert extra > 0.8 * worn.tau_c
    assert worn not in believed.effects
    assert not any(effect.name in {"payload", "external_contact"} for effect in believed.effects)
    for known, effect in zip(believed.effects, true.effects, strict=False):
        if isinstance(known, CoulombFriction):
            assert effect.tau_c != known.tau_c  # off, and
            assert effect.tau_c == pytest.approx(known.tau_c, rel=0.31)  # inside two tolerances
    masses = [
        (body.mass, true.model.inertials[name].mass)
        for name, body in believed.model.inertials.items()
    ]
    assert all(own == pytest.approx(stated, rel=0.041) for stated, own in masses)


@pytest.mark.parametrize("held", [True, False])
def test_the_page_says_what_holds_and_what_is_missed(held, tmp_path: Path) -> None:
    felt = np.array([0, 4_000_000]), np.array([[0.1, np.nan], [0.2, 0.3]])
    proof = Proof(
        wire_of("mujoco", tmp_path),
        [Step("A step", "0.7 N m", "0.5 N m", held)],
        [felt],
        seconds=3.0,
    )
    whole_page(proof).save(tmp_path / "index.html")
    text = (tmp_path / "index.html").read_text()
    check_page(text)
    assert title_of(text) == f"{int(held)} of 1 steps hold."
    assert ("missed</b>" in text) is not held


def test_a_proof_that_ended_early_does_not_hold(tmp_path: Path) -> None:
    steps = [Step("A step", "0", "0", held=True)]
    assert not Proof(wire_of("mujoco", tmp_path), steps, failure="it broke").held


def test_a_backend_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="`backend` is 'ethercat', expected one of mujoco, fri"):
        prove(tmp_path, "ethercat")
    assert not list(tmp_path.iterdir())


def test_a_bus_that_is_proven_over_is_one_of_this_arm(tmp_path: Path) -> None:
    config = ArmConfig.load(Path(wire_of("can", tmp_path).options[1]))
    assert config.model.name == plant.ROBOT


def test_a_backend_without_the_whole_is_refused_in_one_line(limo, tmp_path: Path) -> None:
    done = limo("demo", "--backend", "fri", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert done.stderr == "limo: --backend says over what --whole goes; give both\n"


def test_a_folder_with_something_in_it_is_refused_in_one_line(limo, tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    done = limo("demo", "--whole", "--out", tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"limo: {tmp_path}: is not empty: give a new folder")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("mass", [None, 0.3])
def test_what_explains_another_motion_leaves_no_more_than_the_true_arm(mass: float | None) -> None:
    true, t = plant.believed(), np.arange(0.0, 8.0, 1.0 / RATE)
    position = 0.3 * np.sin(np.outer(t, 1.0 + 0.2 * np.arange(7)))
    still = Recording.from_arrays(t, position, np.zeros_like(position))
    noise = 0.05 * np.random.default_rng(0).standard_normal(position.shape)
    torque = true.predict(still.motion(BANDWIDTH)) + noise
    wrong = () if mass is None else (Payload(mass=mass, com=(0.0, 0.0, 0.1)),)
    found = replace(true, effects=(*true.effects, *wrong))
    step = judge_explanation(found, true, Recording.from_arrays(t, position, torque))
    assert step.held is (mass is None), step.figure
