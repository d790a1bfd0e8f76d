"""ArmServer: serve one arm on the network: answer states, change models, publish its status."""

from __future__ import annotations

import gc
import threading
import time
from collections import Counter
from pathlib import PurePath
from traceback import format_exc
from typing import TYPE_CHECKING, Any, Final

import zenoh
from zenoh.handlers import RingChannel

from estimators.service.inference.inbox import (
    RING,
    Bulletin,
    FollowedSource,
    Inbox,
    LogWatch,
    NetworkOutlet,
    StateSilence,
)
from estimators.service.inference.live_model import LiveModel, Window
from estimators.service.model_changes import ModelChanges
from estimators.service.opening import ModelQueries, Opening, Retrainer
from estimators.service.store.vetting import Demand
from limo_driver.errors import LimoError, WireFormatError
from limo_driver.network.messages import Attachment, Level, decode_joint_state
from limo_driver.network.readiness import ServicePhase
from limo_driver.network.ros import RosReader, RosTopic
from limo_driver.network.streaming import Keys

if TYPE_CHECKING:
    from collections.abc import Callable

    from estimators.service.inference.arm_service import ArmService
    from estimators.service.settings import ServiceSettings
    from estimators.service.store.served_models import ServedModels
    from limo_driver.logs.mcap_log import McapLog

_WAITING_FOR_STATES: Final = "waiting for joint states"
_ANSWERING: Final = (ServicePhase.SERVING, ServicePhase.SILENT)
_PAUSE: Final = 10.0  # [s] before another try to serve states that could not be served


class ArmServer(ModelChanges):
    """Serves one arm from its first states on, until it is closed.

    Args:
        session: Open Zenoh session, which holds the arm's name; see `Presence`.
        bulletin: Tells events and how far the service is, and knows the arm's keys.
        models: What can serve.
        settings: How.
        log: Where everything is kept, if anywhere.
        ros: Topic of joint states to answer instead of a driver's.

    Raises:
        ConfigError: Contacts are set for an arm with other joints.
    """

    def __init__(
        self,
        session: zenoh.Session,
        bulletin: Bulletin,
        models: ServedModels,
        settings: ServiceSettings,
        log: McapLog | None,
        ros: RosTopic | None = None,
    ) -> None:
        super().__init__(models, NetworkOutlet(session, bulletin, log))
        self.keys, self.settings = bulletin.keys, settings
        self._physics = models.physics
        settings.contact(self._physics.model.n)  # refuses those of an arm with other joints
        self._bulletin = bulletin
        self._opening = Opening(self.arm, models, settings, self.outlet)
        self._logging = None if log is None else LogWatch(log, self.outlet)
        self.service: ArmService | None = None
        self._next_try = 0.0  # [s], of opening the service
        self._refused: Counter[str] = Counter(malformed=0)  # before the service began
        self._told = False  # why something was refused
        self._failures = 0  # of this program
        self._opener: threading.Thread | None = None
        self._source, self._silence = FollowedSource(), StateSilence()
        self.keeper: Retrainer | None = None  # retrains the champion, where there is one
        self._ros = None if ros is None else RosReader(self._physics.model.joint_names, self.arm)
        key = self.keys.joints if ros is None else ros.key_of_any_hash
        self._queries = ModelQueries(session, self)
        self._wait_for_states(f"joint states are waited for on {key}")
        self._drivers: set[str] = set()  # tokens of drivers of other arms
        self._others = session.liveliness().declare_subscriber(
            Keys.of_any().alive("driver"), self._note_driver, history=True
        )
        self._subscriber = session.declare_subscriber(key, RingChannel(RING))
        self._thread = threading.Thread(
            target=self._receive, args=(self._subscriber.handler,), name=f"limo-{self.arm}"
        )
        self._thread.start()

    @property
    def arm(self) -> str:
        """Name of the arm in keys."""
        return self.keys.arm

    @property
    def phase(self) -> ServicePhase | None:
        """How far its service is."""
        return self._bulletin.phase

    @property
    def answering(self) -> bool:
        """Whether joint states are answered, those of the rate that is served."""
        return self._bulletin.phase in _ANSWERING

    @property
    def _preparing(self) -> bool:
        return self._bulletin.phase is ServicePhase.PREPARING

    def tell_changes(self, wake: Callable[[], None]) -> None:
        """Call this, from any thread, when the status should be published again at once."""
        self._bulletin.wake = wake

    def status(self) -> dict[str, Any]:
        """Return the condition since the last call, as JSON values, and publish it."""
        service = self.service
        if service is not None:
            # Tell when joint states end and come again, and for how long there were none
            silence = self._silence
            ended = silence.look(service.arrivals.counts.total(), answering=self.answering)
            if silence.silent:
                text, lasts = f"no joint states for {silence.limit:g} s", silence.lasts
                state = f"silent for {lasts:.0f} s"
                self._bulletin.enter(ServicePhase.SILENT, text, Level.ERROR, state)
            elif ended and self.answering:
                self._bulletin.enter(ServicePhase.SERVING, "joint states come again")
        now: dict[str, Any] = {**self._bulletin.condition(), "counts": dict(self._refused)}
        if service is not None:
            service.end_silent_contacts()
            window, service.window = service.window, Window(len(service.arm.joint_names))
            now |= service.condition(window)
            if self.keeper is not None:
                self.keeper.watch(window)
                now["retraining"] = self.keeper.status()
        now["counts"]["internal_errors"] = self._failures
        if self._logging is not None:
            now["log"] = self._logging.look()
        self._bulletin.status(now)
        return now

    def index(self) -> dict[str, Any]:
        """Return which models there are and which serves, as JSON values."""
        serving = None if self.service is None else self.service.model.version
        return {"arm": self.keys.arm, "serving": serving, **self.models.index()}

    def retrain(self, reason: str) -> dict[str, Any]:
        """Train a challenger as soon as can be, and return the stage of retraining.

        Raises:
            LimoError: The service does not retrain, or cannot now.
        """
        self.running()
        if self.keeper is None:
            raise LimoError("this service does not retrain: it needs `store` and `log`")
        return self.keeper.ask(reason)

    def demand(self) -> Demand:
        """Return the requirements on a version that serves here.

        Raises:
            LimoError: No joint states came yet.
        """
        arm = self.running().arm
        return Demand(arm.rate, self.settings.delay, joints=arm.joint_names)

    def loaded(self, version: str) -> LiveModel:
        """Load a version, with everything compiled that its first answer needs.

        Raises:
            LimoError: It cannot be read, or no joint states came yet.
        """
        return self._opening.loaded(version, self.running().arm)

    def close(self) -> None:
        """Stop answering and take the arm's keys off the network."""
        self.models.close()
        self._queries.close()
        self.finish_changes()
        if self.keeper is not None:
            self.keeper.close()
        self._others.undeclare()
        self._subscriber.undeclare()
        self._thread.join()
        if self._opener is not None:
            self._opener.join()
        self.outlet.close()

    @property
    def _counts(self) -> Counter[str]:
        """Of what is not answered, before the service began and since."""
        return self._refused if self.service is None else self.service.counts

    def running(self) -> ArmService:
        """Return the service, see `ModelChanges`."""
        if self.service is None:
            raise LimoError(f"{self.keys.arm} is not served yet: no joint states came")
        if not self.answering:
            raise LimoError(f"{self.keys.arm} is not served now: {self._bulletin.state}")
        return self.service

    def _receive(self, states: zenoh.Handler[zenoh.Sample]) -> None:
        """Take one state after the other until the subscription ends."""
        inbox = Inbox(states, self._foreign)
        while True:
            try:
                sample, source = inbox.next()
            except zenoh.ZError:  # closed
                return
            try:
                self._take(sample, source)
            except Exception as error:  # noqa: BLE001  # of our own; the stream has to go on
                self._failures += 1
                if self._failures == 1:
                    self.outlet.event("failure", f"{error!r}", Level.FATAL, trace=format_exc())

    def _foreign(self, source: str) -> bool:
        """Say whether a state is of another source; those of ROS say so in what is attached."""
        if self._ros is not None or not self._source.is_foreign(source):
            return False
        self._counts["foreign"] += 1
        return True

    def _take(self, sample: zenoh.Sample, source: str) -> None:
        payload = sample.payload.to_bytes()
        attachment = b"" if sample.attachment is None else sample.attachment.to_bytes()
        if self._ros is not None:
            try:
                payload, about, source = self._ros.read(payload, attachment)
            except WireFormatError as error:
                self._refuse(error)
                return
            attachment = about.encode()
        if self._source.is_foreign(source):
            self._counts["foreign"] += 1
            return
        if self.answering and self.service is not None:
            if self.service.handle(payload, attachment):
                self._follow(source)
            if self.service.other_rate is not None:
                self._stop_for(self.service.arm.rate, self.service.other_rate)
        elif not self._preparing and time.monotonic() >= self._next_try:
            self._find_rate(payload, attachment, source)

    def _wait_for_states(self, text: str) -> None:
        self._bulletin.enter(ServicePhase.WAITING, text, state=_WAITING_FOR_STATES)

    def _note_driver(self, sample: zenoh.Sample) -> None:
        """Note a driver that comes or goes, and say whose there are while states are waited for."""
        token = str(sample.key_expr)
        if (other := token.split("/")[1]) == self.arm:
            return
        if sample.kind == zenoh.SampleKind.PUT:
            self._drivers.add(token)
        else:
            self._drivers.discard(token)
        if self._bulletin.phase is ServicePhase.WAITING and token in self._drivers:
            state = f"{_WAITING_FOR_STATES} of {self.arm!r}: a driver of {other!r} is there"
            self._bulletin.enter(ServicePhase.WAITING, state, state=state)
            self.outlet.event("other-arm", state, Level.WARN, other=other)

    def _follow(self, source: str) -> None:
        """Keep to the source of a state, and tell when another one sends at the same time."""
        if (text := self._source.follow(source)) is not None:
            self.outlet.event("foreign", text, Level.ERROR)

    def _stop_for(self, rate: float, found: float) -> None:
        """Answer no states of another rate: velocities and memory would be wrong by it."""
        text = f"joint states came at {found:g} Hz, {rate:g} Hz was served"
        anew = self.settings.rate is None
        then = (
            "the service begins anew" if anew else "they are not answered: another rate was given"
        )
        self.outlet.event("rate", f"{text}; {then}", Level.ERROR, given=rate, found=found)
        if anew:
            self._wait_for_states("the rate of the joint states is found anew")
        else:
            why = f"refused: {text}"
            self._bulletin.enter(ServicePhase.REFUSED, f"{text}; {then}", Level.ERROR, why)

    def _refuse(self, error: WireFormatError) -> None:
        """Count what is no joint state of this arm, and tell why the first one is none."""
        self._counts["malformed"] += 1
        if not self._told:
            self._told = True
            self.outlet.event("refused", str(error), Level.ERROR)

    def _refuse_joints(self, names: tuple[str, ...]) -> None:
        """Say that states of another robot come in this arm's name, once."""
        self._counts["foreign"] += 1
        if self._bulletin.phase is ServicePhase.WAITING:
            model = self._physics.model
            text = (
                f"joint states of {', '.join(names) or 'no joint'} came, and {self.arm!r} is "
                f"served as {PurePath(model.name).stem}, of {', '.join(model.joint_names)}"
            )
            state = f"refused: {text}"
            self._bulletin.enter(ServicePhase.REFUSED, text, Level.ERROR, state)

    def _find_rate(self, payload: bytes, attachment: bytes, source: str) -> None:
        """Gather states until their rate is known, then open the service."""
        try:
            about = Attachment.decode(attachment)
            state = decode_joint_state(payload)
        except WireFormatError as error:
            self._refuse(error)
            return
        if state.names != tuple(self._physics.model.joint_names):
            self._refuse_joints(state.names)
            return
        self._follow(source)
        first = self.service is None
        rate = self._opening.rate(about.sequence, state.stamp_ns, first=first)
        if rate is None:
            return
        text = f"what answers joint states at {rate:g} Hz is loaded"
        self._bulletin.enter(ServicePhase.PREPARING, text, rate=rate)
        self._opener = threading.Thread(
            target=self._open, args=(rate,), name=f"limo-open-{self.keys.arm}"
        )
        self._opener.start()

    def _open(self, rate: float) -> None:
        try:
            service = self._opening.service(rate)
        except Exception as error:  # noqa: BLE001  # states go on coming, and may be served later
            known = isinstance(error, LimoError)
            why, facts = (str(error), {}) if known else (repr(error), {"trace": format_exc()})
            self._next_try = time.monotonic() + _PAUSE
            text, state = f"cannot serve: {why}", f"refused: {why}"
            self._bulletin.enter(ServicePhase.REFUSED, text, Level.FATAL, state, **facts)
            return
        version = service.model.version
        gc.freeze()  # collecting through what was just loaded would hold the stream
        with self.changing:
            self.service = service
            text = f"{version} serves at {rate:g} Hz"
            self._bulletin.enter(ServicePhase.SERVING, text, rate=rate, version=version)
