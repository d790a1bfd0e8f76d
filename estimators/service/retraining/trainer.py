"""Train a challenger from the newest logs, in a process of its own.

    python -m estimators.service.retraining.trainer models --logs logs --arm iiwa14 --seconds 300

A model of the champion's kind, or of another one, learns what the champion's simulation leaves of
the torque, outside of contact, from states of the newest rate. The last part of the motion is held
out, and challenger and champion are compared on it as they would answer live. The challenger then
is the store's next version, with the champion as its parent; a process that is killed before leaves
nothing. It has the lowest priority and one thread.

The process that trains a challenger, as the service sees it.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.hybrid import HybridModel
from estimators.neural import NETWORKS
from estimators.residual_model import ResidualModel, to_train, trained_by_name
from estimators.service.gate import BLOCK, accuracy, compare, plain
from estimators.service.inference.contact import MARGIN
from estimators.service.retraining.logged_motion import LoggedMotion, Span, newest_motion
from estimators.service.store.aliases import draft
from estimators.service.store.store import ModelStore
from estimators.stream import Stream
from limo_driver.errors import ConfigError, LimoError, ModelStoreError, RecordingError
from limo_driver.runtime.processes import command_of, end_when_abandoned, give_way

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.base import LiveEstimator
    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.service.settings import RetrainingSettings
    from estimators.service.store.version import Version
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

SAME: Final = "same"  # as the champion
_HELD_OUT: Final = 0.2  # of the motion, the last part
_LEAST: Final = 20.0  # [s] of motion, to learn anything from
_NICE: Final = 19


def check_kind(kind: str) -> None:
    """Check that a challenger can be of a kind.

    Raises:
        ConfigError: No estimator that learns beside a service is called so.
        MissingPackageError: It is a network, and PyTorch is not installed.
        PlugInError: It is of another distribution and cannot be used.
    """
    known = (SAME, *trained_by_name(), *NETWORKS)
    if kind not in known:
        raise ConfigError(f"no kind of challenger is {kind!r}; known: {', '.join(known)}")
    if kind in NETWORKS:
        from estimators.hybrid.training.settings import require_torch

        require_torch()
    elif kind != SAME:
        to_train(kind, (SAME, *NETWORKS))


def learned(kind: str, champion: ResidualModel[Any], recording: Recording) -> ResidualModel[Any]:
    """Return a model fitted to the residual of the champion's simulation on a recording.

    Args:
        kind: `same` as the champion, with the settings that it was trained with; an estimator that
            is trained by its name, as `joint-physics`; or a network, with its usual settings.
        champion: Whose simulation, bandwidth and settings.
        recording: To learn from.

    Raises:
        ConfigError: There is no such kind.
        MissingPackageError: PyTorch is not there for a network.
        ModelStoreError: A champion does not say how it was trained.
        RecordingError: The recording says too little.
    """
    check_kind(kind)
    wanted = champion.name if kind == SAME else kind
    if wanted in trained_by_name():
        model = to_train(wanted).unfitted(champion.simulation, champion.bandwidth)
        return model.going_on_from(champion).fit([recording])
    from estimators.hybrid.training.settings import usual_settings

    known = usual_settings("drive", wanted) if wanted in NETWORKS else _settings_of(champion)
    settings = replace(known, bandwidth=champion.bandwidth, device="cpu")
    return HybridModel(champion.simulation, settings).fit([recording])


def _settings_of(champion: ResidualModel[Any]) -> TrainingSettings:
    """Return the settings of a network, as its folder keeps them."""
    from estimators.hybrid.training.settings import TrainingSettings

    record: Mapping[str, Any] = champion.fitted.record
    given = record.get("settings")
    known = {field.name for field in fields(TrainingSettings)}
    if not isinstance(given, dict) or not set(given) <= known:
        raise ModelStoreError(
            "the champion does not say how it was trained; say which kind to train, for example "
            "joint-physics"
        )
    try:
        values: dict[str, Any] = {**given, "without": tuple(given.get("without", ()))}
        return TrainingSettings(**values)
    except TypeError as error:
        raise ModelStoreError(f"the champion's training settings: {error}") from None


def train(
    store: ModelStore, motion: LoggedMotion, delay: float, kind: str = SAME
) -> dict[str, Any]:
    """Fit a challenger, compare it with the champion, and add it to the store.

    Args:
        store: Of the arm's robot; it has a champion.
        motion: To learn from.
        delay: Of the service [s].
        kind: Of the challenger, see `learning`.

    Returns:
        The new version and its metrics, as JSON values.

    Raises:
        LimoError: There is no champion that can be read, no such kind, or too little motion.
    """
    champion = store.open("champion")
    known = champion.load()
    # The motion to learn from, and the last part, which is held out
    moved = len(motion.recording) / motion.recording.rate
    if moved < _LEAST:
        raise RecordingError(
            f"only {moved:.3g} s of motion outside of contact to learn from, expected at least "
            f"{_LEAST:g} s"
        )
    first = round((1.0 - _HELD_OUT) * len(motion.recording))
    learned_from, held_out = (motion.recording[:first], motion.recording[first:])
    model = learned(kind, known, learned_from)
    metrics = _metrics(model, known, held_out, delay)
    record = {
        "metrics": metrics,
        "data": {**motion.origin, "contact_seconds": motion.contact},
    }
    added = _add(store, model, held_out, champion, record, delay)
    return {"version": added.number, "parent": champion.number, **record}


def _metrics(
    challenger: LiveEstimator, champion: LiveEstimator, held_out: Recording, delay: float
) -> dict[str, Any]:
    mine, theirs = (live_errors(model, held_out, delay) for model in (challenger, champion))
    block = min(round(BLOCK * held_out.rate), len(mine))
    rmse = accuracy(mine, block)
    return {
        "held_out_seconds": len(mine) / held_out.rate,
        "rmse": {name: plain(values) for name, values in vars(rmse).items()},
        "against_champion": compare(theirs, mine, block).as_values(),
    }


def live_errors(model: LiveEstimator, recording: Recording, delay: float) -> FloatArray:
    """Return measured less estimated torque as a service would see it, (T, n) [N m].

    Rows in which memory is not full yet, at the start and after gaps, are left out.

    Raises:
        RecordingError: No row is left.
    """
    stream = Stream(model, recording.rate, delay)
    late, _ = stream.advance(stream.init(), recording.time, recording.position, recording.torque)
    settled = np.zeros(len(recording), dtype=bool)
    for rows in recording.segments:
        settled[rows.start + ceil(2 * stream.delay * recording.rate) : rows.stop] = True
    if late.measured is None or not settled.any():
        raise RecordingError(f"no stretch of the held-out motion is longer than {2 * delay:g} s")
    return (late.measured - late.torque)[settled]


def _add(
    store: ModelStore,
    model: ResidualModel[Any],
    golden: Recording,
    parent: Version,
    record: dict[str, Any],
    delay: float,
) -> Version:
    try:
        with draft(store.home) as path:  # is removed by the next writer, should this one be killed
            model.save(path / "model")
            return store.add(
                path / "model", golden=golden, parent=parent.number, record=record, delay=delay
            )
    except OSError as error:
        raise ModelStoreError(f"{store.home}: cannot be written: {error.strerror}") from None


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and print one line of JSON: the version, or the error."""
    parser = argparse.ArgumentParser(description="Train a challenger from the newest logs.")
    parser.add_argument("store", type=Path)
    parser.add_argument("--robot")
    parser.add_argument("--logs", type=Path, required=True, help="folder of the service's logs")
    parser.add_argument("--arm", required=True, help="its name in keys")
    parser.add_argument("--seconds", type=float, required=True, help="of the newest motion")
    parser.add_argument("--rate", type=float, help="of the states [Hz]; that of the newest")
    parser.add_argument("--until", type=int, help="stamp of the newest state [ns]")
    parser.add_argument("--kind", default=SAME, help="of the challenger; as the champion")
    parser.add_argument("--delay", type=float, default=0.1, help="of the service [s]")
    parser.add_argument("--margin", type=float, default=MARGIN, help="around contact [s]")
    parser.add_argument("--limit", type=float, help="after which the process is ended [s]")
    parser.add_argument("--trust", action="append", default=[], type=Path, help="public key")
    parser.add_argument("--sign", type=Path, help="private key")
    parser.add_argument("--attended", action="store_true", help="end when standard input does")
    given = parser.parse_args(arguments)
    if given.attended:
        end_when_abandoned()
    give_way(_NICE)
    if given.limit is not None:
        signal.setitimer(signal.ITIMER_REAL, given.limit)  # ends it also inside compiled code
    store = ModelStore(given.store, given.robot, given.trust, given.sign)
    began = time.monotonic()
    try:
        joints = store.open("champion").joints
        span = Span(given.seconds, given.rate, given.until)
        motion = newest_motion(given.logs, given.arm, joints, span, given.margin)
        with threadpool_limits(1):
            found = train(store, motion, given.delay, given.kind)
    except LimoError as error:
        sys.stdout.write(f"{json.dumps({'error': str(error)})}\n")
        sys.exit(1)
    found["seconds"] = time.monotonic() - began
    sys.stdout.write(f"{json.dumps(found)}\n")


if __name__ == "__main__":
    main()


_COMMAND: Final = command_of("estimators.service.retraining.trainer")
_ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
_GLANCE: Final = 0.01  # [s] that a look at the process takes
_LATE: Final = 10.0  # [s] beyond its limit, after which a process that did not end itself is killed


class TrainingProcess:
    """The trainer in a process of its own, started at once, at low priority and with a time limit.

    Args:
        store: To learn the champion from, and to add to.
        logs: Folder of the service's logs.
        arm: Its name in keys.
        settings: Which kind to learn, and the limit.
        span: What to learn from.
        delay: Of the service [s].
        margin: Left out around contact [s].
    """

    def __init__(
        self,
        store: ModelStore,
        logs: Path,
        arm: str,
        settings: RetrainingSettings,
        span: Span,
        delay: float,
        margin: float,
    ) -> None:
        self._limit = settings.training_limit
        self._ends = time.monotonic() + self._limit + _LATE
        arguments = [str(store.root.resolve()), f"--robot={store.robot}", f"--arm={arm}"]
        arguments += [f"--logs={logs.resolve()}", f"--seconds={span.seconds!r}"]
        arguments += [] if span.rate is None else [f"--rate={span.rate!r}"]
        arguments += [] if span.until_ns is None else [f"--until={span.until_ns}"]
        arguments += [f"--kind={settings.kind}", "--attended"]
        arguments += [f"--delay={delay!r}", f"--margin={margin!r}", f"--limit={self._limit!r}"]
        arguments += [f"--trust={key.resolve()}" for key in store.trusted_keys]
        if store.signing_key is not None:
            arguments.append(f"--sign={store.signing_key.resolve()}")
        held, self._held = os.pipe()  # closed when this process ends, however it does
        try:
            self._process = subprocess.Popen(  # noqa: S603  # our own module
                [*_COMMAND, *arguments],
                stdin=held,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env=os.environ | _ONE_THREAD,
                start_new_session=True,  # Ctrl-C is for the service, which then ends this one
            )
        except BaseException:
            os.close(self._held)
            raise
        finally:
            os.close(held)

    def result(self) -> dict[str, Any] | None:
        """Return what was trained, or None while it goes on.

        Raises:
            LimoError: It failed, and why.
        """
        try:
            out, errors = self._process.communicate(timeout=_GLANCE)
        except subprocess.TimeoutExpired:
            if time.monotonic() < self._ends:
                return None
            self.end()
            raise LimoError(f"training took longer than {self._limit:g} s") from None
        self._let_go()
        try:
            found: object = json.loads(out)
        except ValueError:
            found = None
        if isinstance(found, dict) and "error" in found:
            raise LimoError(f"training failed: {found['error']}")
        if not isinstance(found, dict) or "version" not in found or self._process.returncode:
            raise LimoError(self._why(errors))
        return found

    def end(self) -> None:
        """Kill it, if it still runs; the store is as it was."""
        self._process.kill()
        self._process.communicate()
        self._let_go()

    def _let_go(self) -> None:
        held, self._held = self._held, -1
        if held >= 0:
            os.close(held)

    def _why(self, errors: str) -> str:
        status = self._process.returncode
        if status == -signal.SIGALRM:
            return f"training took longer than {self._limit:g} s"
        told = errors.strip().splitlines()
        return f"training ended with status {status}" + (f": {told[-1]}" if told else "")
