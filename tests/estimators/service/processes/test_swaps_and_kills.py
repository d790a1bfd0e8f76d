"""A real service process: models that take turns, and what is left when something is killed."""

from __future__ import annotations

import subprocess
from collections import defaultdict
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
import pytest
from processes import ARM, PATIENCE, RATE, Answers, driven, limo, served, slow_motion, wait_for

from estimators.model_folder import load_model
from estimators.stream import Stream
from limo_driver.logs.mcap_log import log_files, read_mcap
from limo_driver.network.contact_state import ContactListener, ContactState, Touch
from limo_driver.network.messages import decode_joint_state, decode_torque_estimate
from limo_driver.network.readiness import ModelClient
from limo_driver.network.streaming import Keys, is_alive, open_session
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Generator
    from pathlib import Path

    from processes import Network

    from estimators.service.store.store import ModelStore

pytestmark = [
    pytest.mark.waits,
    pytest.mark.slow("real processes, which start, serve and are killed"),
]

DELAY_NS = 100_000_000
LOST = 1.0  # [s] of data that may be gone after a kill


class Kept:
    """What is in the logs of a folder: states in order, and answers by their stamp."""

    def __init__(self, folder: Path) -> None:
        states = []
        self.answers: dict[int, list[tuple[str, np.ndarray]]] = defaultdict(list)
        for path in log_files(folder):
            for message in read_mcap(path):
                if message.topic == Keys(ARM).joints:
                    states.append(decode_joint_state(message.payload))
                elif message.topic == Keys(ARM).estimate:
                    estimate = decode_torque_estimate(message.payload)
                    self.answers[estimate.stamp_ns].append((estimate.model, estimate.torque))
        self.stamps = [state.stamp_ns for state in states]
        self.position = np.array([state.position for state in states])
        self.measured = np.array([state.torque for state in states])


def test_swaps_lose_nothing_and_cannot_be_seen_between_equal_models(
    store: ModelStore, network: Network, tmp_path: Path
) -> None:
    logs = tmp_path / "logs"
    with (
        open_session(config=network.here) as session,
        driven(session),
        served(network, "--arm", ARM, "--store", store.root, "--log", logs),
    ):
        answers = Answers(session)
        wait_for(lambda: bool(answers.models))
        client = ModelClient(session, ARM)
        for version in ("2", "1", "2"):
            assert client.load(version)["version"] == version
            answers.later()
    assert (np.diff(answers.sequences) > 0).all()
    kept = Kept(logs)
    given = [kept.answers[stamp - DELAY_NS] for stamp in kept.stamps]
    assert [len(answer) for answer in given] == [1] * len(given)
    models = np.array([model for ((model, _),) in given])
    assert (models[1:] != models[:-1]).sum() == 3
    stream = Stream(load_model(store.open(1).path), RATE)
    seconds = 1e-9 * (np.array(kept.stamps) - kept.stamps[0])
    expected, _ = stream.advance(stream.init(), seconds, kept.position, kept.measured)
    np.testing.assert_allclose([t for ((_, t),) in given], expected.torque, atol=1e-6)


def test_a_killed_service_leaves_a_log_and_comes_back_with_the_champion(
    store: ModelStore, network: Network, tmp_path: Path
) -> None:
    given = ("--arm", ARM, "--store", store.root, "--log", tmp_path / "logs")
    with open_session(config=network.here) as session, driven(session):
        stamps: list[int] = []
        session.declare_subscriber(
            Keys(ARM).estimate,
            lambda sample: stamps.append(
                decode_torque_estimate(sample.payload.to_bytes()).stamp_ns
            ),
        )
        answers = Answers(session)
        with served(network, *given) as service:
            wait_for(lambda: bool(answers.models))
            ModelClient(session, ARM).promote("2", "as good")
            answers.later(200)
            service.kill()
            service.wait(PATIENCE)
        wait_for(lambda: not is_alive(session, Keys(ARM).alive("service")))
        kept = Kept(tmp_path / "logs")
        assert max(answers.stamps) - max(kept.answers) <= 1e9 * LOST
        assert store.verify(store.aliases.champion or 0) <= 1e-6
        before = len(answers.models)
        with served(network, *given):
            wait_for(lambda: len(answers.models) > before)
        assert answers.models[before] == "2"


def test_a_listener_knows_nothing_while_no_service_does_and_a_swap_forgets_nothing(
    store: ModelStore, network: Network
) -> None:
    given = ("--arm", ARM, "--store", store.root)
    with open_session(config=network.here) as session, driven(session):
        heard: list[ContactState] = []
        keeping = session.declare_subscriber(
            Keys(ARM).contact,
            lambda sample: heard.append(ContactState.decode(sample.payload.to_bytes())),
        )
        # A machine that tests share hears late: what would be a stall to a controller is none here.
        contacts = ContactListener(session, ARM, patience=5.0)
        assert contacts.of(1) is Touch.UNKNOWN
        with served(network, *given) as service:
            wait_for(lambda: contacts.of(1) is not Touch.UNKNOWN)
            known = len(heard)
            ModelClient(session, ARM).load("2")
            wait_for(lambda: heard[-1].model == "2")
            wait_for(lambda: len(heard) > known + 10)
            gaps = [state.since_gap for state in heard[known:]]
            assert gaps == sorted(gaps)
            assert all(Touch.UNKNOWN not in state.joints for state in heard[known:])
            service.kill()
            service.wait(PATIENCE)
        wait_for(lambda: contacts.of(1) is Touch.UNKNOWN)
        before = len(heard)
        with served(network, *given):
            wait_for(lambda: contacts.of(1) is not Touch.UNKNOWN)
        assert Touch.UNKNOWN in heard[before].joints  # while its memory fills
        contacts.close()
        keeping.undeclare()


@contextmanager
def running(network: Network, trajectory: Path, record: Path) -> Generator[subprocess.Popen[bytes]]:
    """Run `limo run --stream` on an ideal arm in a process of its own."""
    given = ["--backend", "virtual", "--trajectory", trajectory, "--record", record, "--stream"]
    given += ["--name", ARM, "--robot", trajectory.with_name("two_links.urdf")]
    command = limo("run", *given, "--zenoh-config", network.there)
    with subprocess.Popen(command) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_killed_driver_leaves_its_recording_and_the_service_follows_the_next_one(
    store: ModelStore, network: Network, tmp_path: Path, two_links_urdf: Path
) -> None:
    motion = slow_motion(tmp_path, 300.0, two_links_urdf)
    with open_session(config=network.here) as session:
        answers, told = Answers(session), []
        events = session.declare_subscriber(
            Keys(ARM).event, lambda sample: told.append(sample.payload.to_bytes())
        )
        with served(network, "--arm", ARM, "--store", store.root):
            with running(network, motion, tmp_path / "1.parquet"):
                wait_for(lambda: bool(answers.models))
                answers.later(1500)
            last = max(answers.sequences)
            recording = Recording.load(tmp_path / "1.parquet.partial")
            assert recording.time[-1] >= last / 1000.0 - LOST
            wait_for(lambda: not is_alive(session, Keys(ARM).alive("driver")))
            answers.sequences.clear()
            with running(network, motion, tmp_path / "2.parquet"):
                answers.later(50)
            wait_for(lambda: any(b"memory is reset" in payload for payload in told))
        events.undeclare()
