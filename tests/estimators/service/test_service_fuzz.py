"""What the service makes of whatever a network brings: it drops and counts, and serves on."""

from __future__ import annotations

import json
import threading
from random import Random
from typing import TYPE_CHECKING

import numpy as np
import pytest
import zenoh
from lanes import sampled
from malformed import KINDS, NAMES, PERIOD, START, mutated, state
from sessions import sessions_of_two, wait_until

from estimators.residual_model import SimulationOnly
from estimators.service.arm_server import ArmServer
from estimators.service.inference.arm_service import ArmService, ServedArm
from estimators.service.inference.contact import ContactWatchdog
from estimators.service.inference.inbox import Bulletin
from estimators.service.inference.live_model import LiveModel
from estimators.service.opening import _Kept
from estimators.service.settings import ServiceSettings
from estimators.service.store.served_models import OneFolder
from estimators.stream import Stream
from limo_driver.errors import ConfigError
from limo_driver.network.messages import (
    Attachment,
    JointStateCodec,
    RosAttachment,
    TorqueEstimate,
    decode_torque_estimate,
)
from limo_driver.network.ros import RosTopic
from limo_driver.network.streaming import Keys

if TYPE_CHECKING:
    from limo_driver.network.messages import Event
    from limo_driver.physics import Simulation

pytestmark = pytest.mark.waits

RATE, DELAY = 100.0, 0.1
KEYS = Keys("arm")


class Answers:
    """An outlet that keeps the estimates, by the number of the state that they answer."""

    def __init__(self) -> None:
        self.estimates: dict[int, TorqueEstimate] = {}
        self.kinds: list[str] = []

    def estimate(self, payload: bytes, attachment: bytes, _stamp_ns: int) -> None:
        self.estimates[Attachment.decode(attachment).sequence] = decode_torque_estimate(payload)

    external_wanted = known_wanted = True

    def external(self, *_: object) -> None:
        """Is in the estimate."""

    def known(self, *_: object) -> None:
        """Is not looked at."""

    def contact(self, *_: object) -> None:
        """Is not looked at."""

    def state(self, *_: object) -> None:
        """Is not looked at."""

    def event(self, kind: str, *_: object, **__: object) -> None:
        self.kinds.append(kind)


def serving(rigid: Simulation) -> tuple[ArmService, Answers]:
    answers = Answers()
    bound = np.full(2, 1e3)
    physics = LiveModel("physics", Stream(rigid, RATE, DELAY), bound, physics_only=True)
    watchdog = ContactWatchdog(np.full(2, 3.0), np.full(2, 0.15))
    service = ArmService(ServedArm("arm", NAMES, RATE, 60.0), physics, watchdog, answers)
    service.model = LiveModel("champion", Stream(rigid, RATE, DELAY), bound)
    return service, answers


@pytest.fixture(scope="module")
def undisturbed(rigid: Simulation) -> dict[int, TorqueEstimate]:
    service, answers = serving(rigid)
    for t in range(600):
        service.handle(*state(t))
    return answers.estimates


class TestBetweenStates:
    @pytest.mark.parametrize("kind", KINDS)
    def test_malformed_ones_change_nothing(self, rigid, undisturbed, kind) -> None:
        service, answers = serving(rigid)
        random = Random(kind)  # noqa: S311
        for t in range(100):
            service.handle(*KINDS[kind](random, t))
            service.handle(*state(t))
        assert service.counts["malformed"] + service.counts["foreign"] == 100
        assert service.counts["failures"] == service.counts["unanswered"] == 0
        assert list(answers.estimates) == list(range(100))
        for t, estimate in answers.estimates.items():
            np.testing.assert_array_equal(estimate.torque, undisturbed[t].torque)

    @sampled("seed", range(4), "streams seconds each")
    def test_forged_ones_leave_the_champion_and_are_recovered_from(
        self, rigid, undisturbed, seed
    ) -> None:
        service, answers = serving(rigid)
        random = Random(seed)  # noqa: S311
        for t in range(300):
            service.handle(*mutated(random, t))
            service.handle(*state(t))
        for t in range(300, 600):
            service.handle(*state(t))
        assert service.model.version == "champion"
        assert service.counts["failures"] == 0
        assert all(np.isfinite(e.torque).all() for e in answers.estimates.values())
        # A hundred states in a row are believed, and memory is full after two delays.
        settled = range(300 + 100 + 30, 600)
        torque = np.array([answers.estimates[t].torque for t in settled])
        expected = np.array([undisturbed[t].torque for t in settled])
        np.testing.assert_allclose(torque, expected, atol=1e-6)

    def test_a_clock_that_is_set_back_is_followed(self, rigid) -> None:
        service, answers = serving(rigid)
        for t in [*range(50_000, 50_050), *range(200)]:
            service.handle(*state(t))
        assert set(range(101, 200)) <= set(answers.estimates)
        assert service.arrivals.counts["restarts"] == 1
        assert answers.kinds.count("reset") == 1
        assert service.model.version == "champion"


class Served:
    """A service of its own session, and another session that sends to it."""

    def __init__(self, folder, rigid, ros: RosTopic | None = None, rate=None) -> None:
        self._both = sessions_of_two(folder)
        own, self.session = self._both.__enter__()
        self.events: list[Event] = []
        settings = ServiceSettings(rate=rate, delay=DELAY)
        models = OneFolder("7", SimulationOnly(rigid))
        bulletin = Bulletin(KEYS, self.events.append)
        self.server = ArmServer(own, bulletin, models, settings, None, ros)
        self.answered: set[int] = set()
        self._estimates = self.session.declare_subscriber(KEYS.estimate, self._note)

    def _note(self, sample: zenoh.Sample) -> None:
        if str(sample.key_expr) == KEYS.estimate:  # not what this session put everywhere
            self.answered.add(Attachment.decode(sample.attachment.to_bytes()).sequence)

    def __enter__(self) -> Served:
        return self

    def __exit__(self, *_: object) -> None:
        self.server.close()
        self._estimates.undeclare()
        self._both.__exit__(None, None, None)

    def put(self, t: int, period: int, start: int = START) -> None:
        """Send a state of an arm at rest."""
        codec, values = JointStateCodec(NAMES, "arm"), np.zeros(2)
        payload = codec.encode(start + t * period, values, values, values)
        self.session.put(KEYS.joints, payload, attachment=Attachment(t, t).encode())

    def begin(self, send) -> int:
        """Send states until they are answered, and return the next one's number."""
        sent = 0

        def answered() -> bool:
            nonlocal sent
            send(sent)
            sent += 1
            return bool(self.answered)

        wait_until(answered)
        return sent


class TestOverTheNetwork:
    def test_states_between_malformed_messages_are_answered(self, rigid, tmp_path) -> None:
        with Served(tmp_path, rigid) as served:
            session, random = served.session, Random(0)  # noqa: S311

            def send(t: int) -> None:
                payload, attachment = state(t)
                session.put(KEYS.joints, payload, attachment=attachment)

            def spoil(t: int, kind: str) -> None:
                payload, attachment = KINDS[kind](random, t)
                key = random.choice([KEYS.joints, "limo/*/state/*", "limo/**"])
                session.put(key, payload, attachment=attachment or None)

            for kind in KINDS:  # before its rate is known
                spoil(0, kind)
            first = served.begin(send)
            for t in range(first, first + 200):
                spoil(t, list(KINDS)[t % len(KINDS)])
                send(t)
                wait_until(lambda t=t: t in served.answered)
            status = served.server.status()
            assert status["model"] == "7"
            assert status["counts"]["malformed"] + status["counts"]["foreign"] >= 200
            assert not [e for e in served.events if e.kind in {"failure", "fallback"}]

    def test_malformed_queries_are_answered_by_why_not(self, rigid, tmp_path) -> None:
        questions = [
            b"", b"{", b"[]", b"null", b"\xff\xfe", b"{}", b'{"version": ""}',
            b'{"version": {}}', b'{"version": "../../etc"}', b'{"version": -1}',
            b'{"version": true}', b'{"version": "\\ud800"}', b"[" * 100_000,
            b'{"version": "' + b"9" * 5000 + b'"}', b'{"version": ' + b"9" * 4000 + b"}",
            b'{"version": "8", "reason": "\\udfff"}',
        ]  # fmt: skip
        with Served(tmp_path, rigid) as served:
            served.begin(
                lambda t: served.session.put(KEYS.joints, state(t)[0], attachment=state(t)[1])
            )
            for verb in ("load", "promote", "rollback"):
                for question in questions:
                    replies = list(
                        served.session.get(KEYS.model(verb), payload=question, timeout=60.0)
                    )
                    assert len(replies) == 1, (verb, question[:40])
                    assert replies[0].err, (verb, question[:40])
                    assert json.loads(replies[0].err.payload.to_bytes())["error"]
            assert served.server.index()["serving"] == "7"

    def test_a_ros_node_is_served(self, rigid, tmp_path) -> None:
        """Its joints in another order, with one that the arm does not have."""
        topic = RosTopic(domain=9)
        codec = JointStateCodec(("elbow", "gripper", "shoulder"), "base_link")
        gripper = JointStateCodec(("gripper",), "base_link")
        key = topic.key.replace("RIHS01_", "RIHS02_")  # of another release

        with Served(tmp_path, rigid, topic) as served:

            def send(t: int) -> None:
                values = np.array([np.cos(0.01 * t), 0.02, np.sin(0.01 * t)])
                stamp = START + t * PERIOD
                attachment = RosAttachment(t, stamp, bytes(16)).encode()
                served.session.put(
                    key, codec.encode(stamp, values, 0 * values, values), attachment=attachment
                )

            def grip(t: int) -> bytes:
                """Send its gripper alone."""
                one = np.zeros(1)
                payload = gripper.encode(START + t, one, one, one)
                attachment = RosAttachment(t, START + t, bytes(16)).encode()
                served.session.put(key, payload, attachment=attachment)
                return payload

            def spoil(t: int) -> None:
                """Its gripper alone, a message of no ROS node, and none at all."""
                payload = grip(t)
                served.session.put(key, payload, attachment=state(t)[1])
                served.session.put(key, b"")

            def heard() -> bool:
                grip(0)
                return served.server.status()["counts"]["malformed"] > 0

            wait_until(heard)  # what is sent before sessions know of each other is lost
            first = served.begin(send)
            for t in range(first, first + 100):
                spoil(t)
                send(t)
                wait_until(lambda t=t: t in served.answered)
            assert served.server.status()["counts"]["malformed"] >= 300
            refused = [event.text for event in served.events if event.kind == "refused"]
            assert len(refused) == 1
            assert "joint states of gripper, without shoulder, elbow" in refused[0]

    @pytest.mark.parametrize("stated", [None, RATE])
    def test_states_of_another_rate_are_not_answered_as_if_they_were(
        self, rigid, tmp_path, stated
    ) -> None:
        with Served(tmp_path, rigid, rate=stated) as served:
            sent = served.begin(lambda t: served.put(t, PERIOD))
            later = START + 60_000_000_000

            def until(condition, period: int) -> None:
                def sends() -> bool:
                    nonlocal sent
                    served.put(sent, period, later)
                    sent += 1
                    return condition()

                wait_until(sends)

            until(lambda: "rate" in [event.kind for event in served.events], PERIOD // 4)
            told = next(event for event in served.events if event.kind == "rate")
            assert told.facts == {"given": 100.0, "found": 400.0}
            if stated is None:
                until(lambda: served.server.status().get("rate") == 400.0, PERIOD // 4)
                return
            assert served.server.status()["state"].startswith("refused: joint states came at 400")
            later += 600_000_000_000
            until(lambda: served.server.status()["state"] == "serving", PERIOD)
            assert served.server.status()["rate"] == 100.0

    def test_a_second_source_is_not_answered_until_the_first_is_silent(
        self, rigid, tmp_path
    ) -> None:
        with Served(tmp_path, rigid) as served:
            sent = served.begin(lambda t: served.put(t, PERIOD))
            other = served.session.declare_publisher(KEYS.joints)
            source = zenoh.SourceInfo(other.id, 0)

            def both() -> bool:
                nonlocal sent
                payload, attachment = state(sent)
                other.put(payload, attachment=attachment, source_info=source)
                served.put(sent + 1, PERIOD)
                sent += 2
                return "foreign" in [event.kind for event in served.events]

            wait_until(both)
            assert served.server.status()["counts"]["foreign"]
            last, before = sent, len(served.answered)

            def alone() -> bool:
                nonlocal last
                payload, attachment = state(last)
                other.put(payload, attachment=attachment, source_info=source)
                last += 1
                return len(served.answered) > before + 5

            wait_until(alone)
            assert [event.kind for event in served.events].count("foreign") == 1

    def test_another_arm_is_named_in_one_line_and_not_answered(self, rigid, tmp_path) -> None:
        with Served(tmp_path, rigid) as served:
            _ = served.session.liveliness().declare_token(Keys("right").alive("driver", "1"))
            waits = "waiting for joint states of 'arm': a driver of 'right' is there"
            wait_until(lambda: served.server.status()["state"] == waits)
            none = np.zeros(2)
            payload = JointStateCodec(("hip", "knee"), "arm").encode(START, none, none, none)
            refused = "refused: joint states of hip, knee came, and 'arm' is served as"

            def is_refused() -> bool:
                served.session.put(KEYS.joints, payload, attachment=Attachment(0, 0).encode())
                return served.server.status()["state"].startswith(refused)

            wait_until(is_refused)
            assert not served.answered

    def test_silence_is_told_and_its_end(self, rigid, tmp_path, monkeypatch) -> None:
        monkeypatch.setattr("estimators.service.inference.inbox._DEAD", 0.5)
        with Served(tmp_path, rigid) as served:
            assert served.server.status()["state"] == "waiting for joint states"
            sent = served.begin(lambda t: served.put(t, PERIOD))
            wait_until(lambda: served.server.status()["state"].startswith("silent for"))
            served.put(sent, PERIOD)
            wait_until(lambda: served.server.status()["state"] == "serving")
            kinds = [event.kind for event in served.events]
            assert kinds.count("silent") == 1
            assert kinds[-1] == "serving"
            assert served.server.status()["counts"]["internal_errors"] == 0

    def test_threads_end_with_the_service(self, rigid, tmp_path) -> None:
        with Served(tmp_path, rigid):
            assert "limo-arm" in {thread.name for thread in threading.enumerate()}
        assert "limo-arm" not in {thread.name for thread in threading.enumerate()}


def test_of_a_flood_that_asks_for_the_index_all_are_answered_and_few_read_it():
    class Query:
        key_expr = "limo/arm/model/index"  # and no payload that could be read

        def __init__(self):
            self.said = []

        def reply(self, _key, payload):
            self.said.append(payload)

        def reply_err(self, payload):
            self.said.append(payload)

    read, times, asked = [], [0.0], [Query() for _ in range(1000)]
    index = _Kept(lambda: read.append(1) or {"read": len(read)}, clock=lambda: times[0])
    for query in asked[:-1]:
        index.answer(query)
    times[0] = 1.0
    index.answer(asked[-1])
    assert [query.said for query in asked] == [[b'{"read": 1}']] * 999 + [[b'{"read": 2}']]

    def fails() -> dict:
        read.append(1)
        raise ConfigError("no store")

    broken, query = _Kept(fails, clock=lambda: 0.0), Query()
    for _ in range(2):
        broken.answer(query)
    assert query.said == [b'{"error": "no store"}'] * 2
    assert len(read) == 3
