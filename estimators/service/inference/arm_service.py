"""One arm's states in, its estimates out: what runs a thousand times a second."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.embedded.contact import TURNED
from estimators.service.inference.contact import SURE, Contact, ContactReport, ContactWatchdog
from estimators.service.inference.live_model import Answer, History, LiveModel, RateWatch, Window
from estimators.slow_change import ChangeWatch
from limo_driver.errors import LimoError, WireFormatError
from limo_driver.network.contact_state import ContactState
from limo_driver.network.external_torque import ExternalTorque
from limo_driver.network.messages import (
    Attachment,
    EstimateDraft,
    JointStateMessage,
    Level,
    LiveJointStateCodec,
    TorqueEstimateCodec,
    relabelled,
)
from limo_driver.network.streaming import Arrivals
from limo_driver.robot.realtime import LatencyHistogram
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from estimators.service.inference.inbox import NetworkOutlet
    from limo_driver.types import FloatArray

_FALLBACK_MEMORY: Final = 1.0  # [s] of history that the physics-only model is primed with
_CONTACTS: Final = 1000  # kept, for whoever judges models on what came before
_CLOSE: Final = 20  # states that may be left to catch up with while the stream waits
_SILENCE: Final = 1.0  # [s] without states, after which nothing is known of a contact
_NANOSECONDS: Final = 1e-9
_RESET_PAUSE: Final = 1.0  # [s] between events that memory began anew
_FARTHEST: Final = 1e3  # [rad] that no joint has turned by
_STRONGEST: Final = 1e5  # [N m] that no joint has felt


@dataclass(frozen=True)
class ServedArm:
    """Arm that is served, and how its answers are limited and remembered."""

    name: str
    joint_names: tuple[str, ...]
    rate: float  # [Hz]
    history: float = 120.0  # [s] kept, from which another model's memory is made
    bound: FloatArray = field(default_factory=lambda: np.empty(0))  # (n,) [N m]
    units: tuple[str, ...] = ()  # (n,), of the joints' torques; N m if not given


class ArmService:
    """Answers the joint states of one arm with the model that serves.

    States come through `handle`, one at a time; `swap` may be called from another thread, and takes
    effect between two states.

    Args:
        arm: Arm and rate.
        fallback: Physics only; it serves where the model fails.
        watchdog: Of contact.
        outlet: Where results go.
    """

    def __init__(
        self, arm: ServedArm, fallback: LiveModel, watchdog: ContactWatchdog, outlet: NetworkOutlet
    ) -> None:
        self.arm, self.watchdog = arm, watchdog
        self._outlet = outlet
        n = len(arm.joint_names)
        self.history = History(n, round(arm.history * arm.rate))
        self.arrivals = Arrivals()
        self.counts: Counter[str] = Counter(malformed=0, foreign=0, stale=0, swaps=0, failures=0)
        self.latency = LatencyHistogram()  # from state taken to estimate out
        self.age = LatencyHistogram()  # of a state when its estimate goes out, if clocks agree
        self.window = Window(n)
        self.contacts: deque[Contact] = deque(maxlen=_CONTACTS)  # that ended, oldest first
        self.other_rate: float | None = None  # [Hz] of the states; nothing is answered any more
        self._untold_resets, self._next_reset = 0, 0.0  # and when the next is told [s]
        self._leaving: LiveModel | None = None  # the model before, for one state more
        self._told_joints = False  # that states of other joints came
        self._rate = RateWatch(arm.rate)
        self._states = LiveJointStateCodec(arm.joint_names, arm.name)
        self._estimates = TorqueEstimateCodec(arm.joint_names, arm.name)
        self._fallback = self.model = fallback
        self._boundary = threading.Lock()  # held while a state is answered
        self._origin: int | None = None  # [ns], stamp of the first state
        self._last = np.nan  # [s], of the last state
        self._measured = False  # torque comes with the states
        self._settled, self._began = np.inf, np.nan  # [s], when the filter is full, memory began
        self._report = ContactReport(watchdog)
        self._lowest = np.full(n, np.inf)  # [rad], since memory began anew
        self._highest = np.full(n, -np.inf)
        _possible(self._lowest, self._highest)  # compiles
        self._unturned = np.ones(n, dtype=np.bool_)  # friction of these may stand anyhow
        self._all_turned = False
        self._came = np.inf  # [s], of this machine's clock, when the last state did

    @property
    def model(self) -> LiveModel:
        """The one that answers."""
        return self._model

    @model.setter
    def model(self, model: LiveModel) -> None:
        self._model = model
        draft = EstimateDraft(self._estimates, model.version, fallback=model.physics_only)
        self._draft = draft
        self._answer = Answer(draft.torque, draft.std, draft.external, draft.outside)
        self._changes = ChangeWatch(self.arm.joint_names, self.arm.units)

    def handle(self, payload: bytes, attachment: bytes) -> bool:
        """Answer a joint state off the wire, and say whether it was a good one of this arm."""
        began = time.perf_counter()
        try:
            about = Attachment.decode(attachment)
            state = self._states.decode(payload)
        except WireFormatError:
            self.counts["malformed"] += 1
            return False
        if not self._usable(state):
            return False
        with self._boundary:
            new = self.arrivals.take(about.sequence, state.stamp_ns)
            if not new or self.other_rate is not None:
                return True
            if about.stale:  # its values are the last known ones, and were answered
                self.counts["stale"] += 1
                return True
            try:
                self._reply(state, attachment, began)
            except LimoError:  # not even physics could; begin anew with the next state
                self.counts["unanswered"] += 1
                self._last = np.nan
            self.other_rate = self._rate.take(about.sequence, state.stamp_ns)
            self._outlet.state(payload, state.stamp_ns, about.sequence)
        return True

    def swap(self, model: LiveModel) -> LiveModel:
        """Let another model serve from the next state on, and return the one that did.

        Its memory becomes what it would be had it served since memory last began. It is that of the
        model before where that has the same, or else is made as far back as states are kept; the
        stream goes on meanwhile.

        Raises:
            LimoError: The model cannot follow the states kept; the old one serves on.
        """
        with self._boundary:
            if model.stream.remembers_like(self.model.stream):
                # reaches back further than any history; the one before still says its last word
                model.state = self.model.stream.copied(self.model.state)
                return self._replaced_by(model)
        first = model.catch_up(self.history, close=_CLOSE)
        with self._boundary:
            if first >= self.history.began:
                model.follow(self.history.since(first))
            else:
                model.catch_up(self.history, close=0)
            return self._replaced_by(model)

    def condition(self, window: Window) -> dict[str, Any]:
        """Return the present model, and a summary of the answers in a window, as JSON values."""
        model = self.model
        return {
            "model": model.version,
            **{name: getattr(model, name) for name in ("physics_only", "compiled")},
            "rate": self.arm.rate,
            "delay": model.stream.delay,
            "bound": self.arm.bound.tolist(),
            "answered": window.count,
            "external_rms": [None if np.isnan(v) else v for v in window.rms.tolist()],
            "outside": window.outside.astype(int).tolist(),
            "clipped": window.clipped,
            "contact": self.watchdog.active.tolist(),
            "changed": list(self._changes.lines),
            "arrivals": dict(self.arrivals.counts),
            "counts": dict(self.counts),
            "latency": self.latency.take().as_json(),
            "age": self.age.take().as_json(),
        }

    @property
    def latest_stamp(self) -> int | None:
        """Unix time of the newest state by its source [ns], if one was answered."""
        return None if np.isnan(self._last) else self._stamp(self._last)

    def _replaced_by(self, model: LiveModel) -> LiveModel:
        before, self.model = self.model, model
        self._leaving = before
        self.counts["swaps"] += 1
        return before

    def end_silent_contacts(self) -> None:
        """End the contacts of an arm whose states no longer come."""
        patience = max(_SILENCE, self.model.stream.longest_gap)
        with self._boundary:
            if self.watchdog.active.any() and time.monotonic() - self._came > patience:
                self._cut_contacts_off()

    def _usable(self, state: JointStateMessage) -> bool:
        if state.names != self.arm.joint_names:
            if not self._told_joints:
                self._told_joints = True
                self._outlet.event(
                    "refused",
                    f"joint states of {', '.join(state.names) or 'no joint'}, "
                    f"expected {', '.join(self.arm.joint_names)}",
                    Level.ERROR,
                )
            self.counts["foreign"] += 1
            return False
        if not (state.position.size and _possible(state.position, state.torque)):
            self.counts["malformed"] += 1
            return False
        return True

    def _reply(self, state: JointStateMessage, attachment: bytes, began: float) -> None:
        """Publish the estimate for a state, taken at `began` [s], and then what follows from it."""
        if self._origin is None:
            self._origin = state.stamp_ns
        now = _NANOSECONDS * (state.stamp_ns - self._origin)
        measured = bool(state.torque.size)
        gap = now - self._last
        stream = self.model.stream
        if not 0 < gap <= stream.longest_gap or measured != self._measured:
            self._measured = measured
            self._restart(now, _why_anew(gap, stream.longest_gap, measured=measured))
        elif gap > stream.longest_step:  # memory outlives it; the filter fills anew
            self._settled = now + 2.0 * stream.delay
        self._last = now
        torque = state.torque if measured else None
        reset = now < self._settled
        known = not (reset or self._rate.doubtful)  # velocities, but for noise
        self._step(now, state.position, torque)
        answer = self._answer
        self._flag(answer, state.position, known=known)
        self._publish(state, attachment, reset=reset)
        self._came = time.monotonic()
        self.latency.add(time.perf_counter() - began)
        self.age.add(_NANOSECONDS * (time.time_ns() - state.stamp_ns))
        self.history.append(now, state.position, torque)
        unsure = np.where(self._unturned, np.nan, np.where(answer.outside, SURE * answer.std, 0.0))
        felt = answer.external - np.clip(answer.external, -unsure, unsure)
        for contact in self.watchdog.step(now, felt) if known else ():
            self._tell(contact, now)
        inside = np.where(answer.outside, np.nan, answer.external)
        if self._report.step(now, inside, answer.std, known=known):
            self._tell_contacts(now)
            free = known & ~self.watchdog.active
            given = answer.external, answer.std, free, state.position
            for line in self._changes.step(now, *given):
                self._outlet.event("changed", line, Level.WARN)
        self.window.add(answer, self.watchdog.active, self._unturned, known=known)
        if self._leaving is not None:  # tell by how much torque stepped, of the first state after
            before, self._leaving = self._leaving, None
            answer = Answer.of(len(self.arm.joint_names))
            with suppress(LimoError):  # it may have been replaced because it fails
                before.step(now, state.position, torque, answer)
                step = np.abs(answer.torque - self._answer.torque)
                j = int(step.argmax())
                self._outlet.event(
                    "step",
                    f"{self.model.version} after {before.version}: torque steps by at most "
                    f"{step[j]:.2g} N m, at joint {j + 1}",
                    version=self.model.version,
                    before=before.version,
                    step=step.tolist(),
                )

    def _step(self, now: float, position: FloatArray, torque: FloatArray | None) -> None:
        try:
            self._model.step(now, position, torque, self._answer)
        except LimoError as error:
            if self.model is self._fallback:
                raise
            self.counts["failures"] += 1
            failed, self.model = self.model, self._fallback
            kept, memory = self.history, round(_FALLBACK_MEMORY * self.arm.rate)
            self._fallback.prime(kept.since(max(kept.first, kept.count - memory)))
            self._outlet.event(
                "fallback",
                f"model {failed.version} failed, physics alone serves: {error}",
                Level.ERROR,
                version=failed.version,
            )
            self._fallback.step(now, position, torque, self._answer)

    def _flag(self, answer: Answer, position: FloatArray, *, known: bool) -> None:
        """Flag joints as outside that have not turned enough since memory began.

        Until the filter is full of motion, and while states seem to come at another rate, nobody
        knows how wrong velocities are, nor then the torque.
        """
        if not known:
            answer.outside.fill(True)
            answer.std.fill(np.nan)
        if self._all_turned:
            return
        np.minimum(self._lowest, position, out=self._lowest)
        np.maximum(self._highest, position, out=self._highest)
        self._unturned = self._highest - self._lowest < TURNED
        self._all_turned = not self._unturned.any()
        answer.outside |= self._unturned

    def _restart(self, now: float, why: str) -> None:
        """Begin memory anew: before the first state, or after a gap that cannot be bridged."""
        first = np.isnan(self._last)
        self.history.restart()
        self.model.state = self.model.stream.init()
        self._cut_contacts_off()
        self._lowest.fill(np.inf)
        self._highest.fill(-np.inf)
        self._unturned, self._all_turned = np.ones_like(self._unturned), False
        self._began, self._settled = now, now + 2.0 * self.model.stream.delay
        if not first:
            self.counts["resets"] += 1
            self._tell_reset(why)

    def _tell_reset(self, why: str) -> None:
        """Tell the first at once, then one a second, so that other events are not pushed out."""
        self._untold_resets += 1
        if time.monotonic() < self._next_reset:
            return
        count, self._untold_resets = self._untold_resets, 0
        self._next_reset = time.monotonic() + _RESET_PAUSE
        times = f", {count} times since it was last told" if count > 1 else ""
        self._outlet.event("reset", f"memory is reset {why}{times}", Level.WARN, count=count)

    def _cut_contacts_off(self) -> None:
        for contact in self.watchdog.restart():
            self._tell(contact, contact.ended or contact.began)

    def _tell_contacts(self, now: float) -> None:
        """Say of each joint whether something leans on it, nothing does, or nobody knows."""
        model, report, delay = self.model, self._report, self.model.stream.delay
        since = tuple(self._stamp(time - delay) for time in report.since)
        about = model.version, model.physics_only, now - self._began
        self._outlet.contact(ContactState(self._stamp(now - delay), report.joints, since, *about))

    def _stamp(self, time: float) -> int:
        """Return the Unix time [ns] of a time of the stream [s]."""
        return (self._origin or 0) + round(time / _NANOSECONDS)

    def _tell(self, contact: Contact, now: float) -> None:
        """Tell of a contact; `state_stamp` is of the state that told, others of the torque."""
        self.window.contacts += 1
        delay = self.model.stream.delay
        facts: dict[str, Any] = {
            "joint": contact.joint,
            "torque": contact.torque,
            "state_stamp": self._stamp(now),
            "began_stamp": self._stamp(contact.began - delay),
        }
        if contact.ended is None:
            self._outlet.event("contact", str(contact), Level.WARN, **facts)
        else:
            self.contacts.append(contact)
            facts["ended_stamp"] = self._stamp(contact.ended - delay)
            facts |= {"lasted": contact.ended - contact.began, "cut_off": contact.cut_off}
            self._outlet.event("contact_end", str(contact), **facts)

    def _publish(self, state: JointStateMessage, attachment: bytes, *, reset: bool) -> None:
        model, draft = self._model, self._draft
        stamp = state.stamp_ns - model.delay_ns
        attachment = relabelled(attachment, model.version)
        gap = self._last - self._began
        self._outlet.estimate(draft.finished(stamp, reset=reset, since_gap=gap), attachment, stamp)
        if self._outlet.external_wanted:
            nothing = state.position[:0]
            payload = self._states.encode(stamp, nothing, nothing, draft.external)
            self._outlet.external(payload, attachment)
        if self._outlet.known_wanted:
            known = ~(draft.outside | np.isnan(draft.std + draft.external))
            torque, std = (np.where(known, of, np.nan) for of in (draft.external, draft.std))
            about = model.version, model.physics_only, gap
            self._outlet.known(ExternalTorque(stamp, torque, std, *about), attachment)


@compiled(reads=("position", "torque"))
def _possible(position: FloatArray, torque: FloatArray) -> bool:
    """Say whether an arm could be there; values that are not finite are nowhere."""
    return bool(np.all(np.abs(position) < _FARTHEST) and np.all(np.abs(torque) < _STRONGEST))


def _why_anew(gap: float, longest: float, *, measured: bool) -> str:
    """Return why memory cannot be kept over a gap between two stamps [s]."""
    if gap <= 0:
        return f"after stamps went back by {-gap:.3f} s"
    if gap <= longest:
        return f"because states {'now' if measured else 'no longer'} carry torque"
    return f"after a gap of {gap:.3f} s"
