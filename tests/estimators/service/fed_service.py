"""A service that is fed states by hand, and an outlet that keeps what it says."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.embedded.compiled_stream import fastest
from estimators.service.inference.arm_service import ArmService, ServedArm
from estimators.service.inference.contact import ContactWatchdog
from estimators.service.inference.live_model import LiveModel
from estimators.stream import Stream
from limo_driver.network.contact_state import ContactState
from limo_driver.network.external_torque import ExternalTorque
from limo_driver.network.messages import (
    Attachment,
    JointStateCodec,
    decode_joint_state,
    decode_torque_estimate,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from limo_driver.network.messages import TorqueEstimate
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording


RATE, DELAY = 100.0, 0.1
NAMES = ("shoulder", "elbow")
START = 1_700_000_000_000_000_000  # [ns]


class Kept:
    """An outlet that keeps everything."""

    def __init__(self) -> None:
        self.estimates: list[TorqueEstimate] = []
        self.attachments: list[Attachment] = []
        self.externals: list[np.ndarray] = []
        self.known_of: list[ExternalTorque] = []
        self.contacts: list[ContactState] = []
        self.states: list[bytes] = []
        self.events: list[tuple[str, dict[str, Any]]] = []

    def estimate(self, payload: bytes, attachment: bytes, stamp_ns: int) -> None:
        self.estimates.append(decode_torque_estimate(payload))
        self.attachments.append(Attachment.decode(attachment))
        assert self.estimates[-1].stamp_ns == stamp_ns

    external_wanted = known_wanted = True

    def external(self, payload: bytes, _attachment: bytes) -> None:
        self.externals.append(decode_joint_state(payload).torque)

    def known(self, news: ExternalTorque, _attachment: bytes) -> None:
        self.known_of.append(ExternalTorque.decode(news.encode()))

    def contact(self, state: ContactState) -> None:
        self.contacts.append(ContactState.decode(state.encode()))

    def state(self, payload: bytes, _stamp_ns: int, _sequence: int) -> None:
        self.states.append(payload)

    def event(self, kind: str, _text: str, _level: int = 20, **facts: object) -> None:
        self.events.append((kind, facts))

    @property
    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.events]

    @property
    def torque(self) -> np.ndarray:
        return np.array([estimate.torque for estimate in self.estimates])


def live(
    model: Any, version: str = "1", bound: float = 1e3, runs: Callable[[Stream], Stream] = fastest
) -> LiveModel:
    return LiveModel(version, runs(Stream(model, RATE, DELAY)), np.full(2, bound))


def in_python(stream: Stream) -> Stream:
    return stream


def service_of(
    rigid: Simulation, model: LiveModel | None = None, history: float = 60.0
) -> tuple[ArmService, Kept]:
    kept = Kept()
    physics = LiveModel("physics", Stream(rigid, RATE, DELAY), np.full(2, 1e3), physics_only=True)
    watchdog = ContactWatchdog(np.full(2, 3.0), np.full(2, 0.15))
    service = ArmService(ServedArm("arm", NAMES, RATE, history), physics, watchdog, kept)
    if model is not None:
        service.model = model
    return service, kept


def messages(
    recording: Recording, *, names: Sequence[str] = NAMES, first: int = 0
) -> list[tuple[bytes, bytes]]:
    codec = JointStateCodec(names, "arm")
    begin = recording.time[0]
    return [
        (
            codec.encode(
                START + round(1e9 * (recording.time[t] - begin)) + first * 10_000_000,
                recording.position[t],
                0 * recording.position[t],
                recording.torque[t],
            ),
            Attachment(first + t, t).encode(),
        )
        for t in range(len(recording))
    ]


def feed(service: ArmService, sent: Sequence[tuple[bytes, bytes]]) -> None:
    for payload, attachment in sent:
        service.handle(payload, attachment)
