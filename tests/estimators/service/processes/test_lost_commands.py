"""Commands that a network loses make an arm jerk: over UDP and Zenoh, that is no contact."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from controller_runs import PATIENT, InStep
from ports import free_port
from processes import PATIENCE, Network
from wandering import wander

import limo_driver as limo
from backends.fri.simulator.arm import Compliance, ControlledArm, SetpointPath
from backends.fri.simulator.connection.port import Address
from backends.fri.simulator.controller import SimulatedController
from backends.fri.simulator.scenario import ControllerScenario
from backends.fri.simulator.session import ControllerSettings
from estimators.service.inference.contact import ContactWatchdog
from estimators.stream import Stream
from limo_driver.physics import CoulombFriction, Simulation, ViscousFriction

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.network.messages import Event

pytestmark = [pytest.mark.waits, pytest.mark.slow("records four motions, two of them at the wire")]

RATE, SECONDS = 100.0, 26.0
POSE = np.array([0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0])  # [rad]
PUSHED, PUSH = 20.0, -15.0  # [s] since commanding began, [N m] on joint 2
SCENARIO = f"""seed: 5
from: commanding
events:
  - {{event: loss, at: 1.0, for: 17.0, fraction: 0.03, direction: to_robot}}
  - {{event: push, at: {PUSHED}, for: 1.5, joint: 2, torque: {PUSH}}}
"""


def arm(coulomb: float) -> Simulation:
    """Return an iiwa 14 with friction."""
    dry = (CoulombFriction(joint=j, tau_c=coulomb) for j in range(1, 8))
    return Simulation("iiwa14", (*dry, *(ViscousFriction(joint=j, f_v=1.0) for j in range(1, 8))))


def swaying(seed: int, seconds: float) -> limo.Trajectory:
    """Return motion of all joints about a pose, from rest."""
    t = np.arange(int(seconds * RATE)) / RATE
    rise = np.clip(t / 2.0, 0.0, 1.0)[:, None]
    rise = rise**3 * (10.0 - 15.0 * rise + 6.0 * rise**2)
    moved = wander(t, np.zeros(7), seed, (0.1, 0.5), (0.03, 0.12))
    position = POSE + rise * moved.position
    velocity = np.gradient(position, t, axis=0)
    still = [position, velocity, np.gradient(velocity, t, axis=0)]
    return limo.Trajectory(t, *still, robot="iiwa14")


def undisturbed(true_arm: Simulation, seed: int) -> limo.Recording:
    """Record the same arm where no command is lost."""
    targets = swaying(seed, 60.0).position
    robot = ControlledArm(true_arm, Compliance(), tuple(targets[0]), seed)
    path = SetpointPath(targets[0], robot.spec.limits.acceleration, int(1000 / RATE))
    states = [robot.advance(path.follow(target, path.steps)) for target in targets]
    position, torque = (np.array([getattr(s, of) for s in states]) for of in ("position", "torque"))
    return limo.Recording.from_arrays(np.arange(len(targets)) / RATE, position, torque)


def test_lost_commands_are_no_contact_and_a_push_is(tmp_path: Path) -> None:
    true_arm, known = arm(0.3), arm(0.25)
    learned, *free = (undisturbed(true_arm, seed) for seed in (1, 2, 4))
    model = limo.train(known, learned, "joint-physics")
    thresholds = limo.contact_thresholds(model, free)
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    scenario = ControllerScenario.load(tmp_path / "scenario.yaml")
    network, port = Network(tmp_path), free_port()
    motion, told = swaying(3, SECONDS), list[tuple[str, dict[str, Any]]]()

    def hear(_arm: str, event: Event) -> None:
        told.append((event.kind, dict(event.facts)))
        if event.facts.get("phase") == "serving":  # the arm moves at the first estimate
            robot._clock._origin = robot._time

    settings = ControllerSettings(
        Address("127.0.0.1", port), period_ms=10, position=tuple(motion.position[0]), **PATIENT
    )
    with (
        SimulatedController(settings, true_arm, scenario) as robot,
        limo.serve(
            "iiwa14",
            model=model,
            settings=limo.ServiceSettings(rate=RATE, free=thresholds),
            config=network.here,
            told=hear,
        ),
        ThreadPoolExecutor(1) as thread,
    ):
        robot._pace = InStep(robot)
        running = thread.submit(robot.run)
        streaming = limo.Streaming(wait_for_estimates=PATIENCE, config=network.there)
        run = limo.run(
            "fri", motion, link={"port": port}, record=tmp_path / "run.parquet", stream=streaming
        )
        robot.stop()
        report = running.result(timeout=PATIENCE).as_json()
    lost = report["scenario"]["to_robot"]["lost"]
    assert lost > 20
    # by its torque alone, there was something at thresholds that hold for free motion
    stream = Stream(model, RATE)
    late, _ = stream.advance(stream.init(), run.time, run.position, run.torque)
    alone = ContactWatchdog(thresholds.torque, np.full(7, 0.15))
    assert late.measured is not None
    felt = late.measured - late.torque
    during = (run.time - run.time[0] > 0.5) & (run.time - run.time[0] < PUSHED - 1.0)
    assert [
        c for t, e in zip(run.time[during], felt[during], strict=True) for c in alone.step(t, e)
    ]
    # which is nothing that is told
    contacts = [facts for kind, facts in told if kind == "contact"]
    assert [facts["joint"] for facts in contacts] == [2]
    assert abs(contacts[0]["torque"]) > 0.5 * abs(PUSH)
