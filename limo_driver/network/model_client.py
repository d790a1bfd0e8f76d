"""Client for the model versions of a running service: list, load, promote, roll back, retrain."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import ConnectionLostError, ModelStoreError
from limo_driver.network.streaming import Keys, is_alive, to_json

if TYPE_CHECKING:
    import zenoh

APPEARING: Final = 3.0  # [s] in which a service that is there is found
STARTING: Final = 10.0  # [s] that one may need from its name to its first answer
VETTING: Final = 180.0  # [s] for a version to be vetted, loaded and given its memory
_INDEX: Final = 10.0  # [s]


class ModelClient:
    """Asks the service of one arm which models it has, and to let another one serve.

    Args:
        session: Open Zenoh session.
        arm: Name of the arm in keys.

    Raises:
        ConfigError: The name cannot be part of a key.
    """

    def __init__(self, session: zenoh.Session, arm: str) -> None:
        self._session, self._keys = session, Keys(arm)

    def index(self) -> dict[str, Any]:
        """Return versions, aliases, and which version serves.

        Raises:
            ConnectionLostError: No service answers.
            ModelStoreError: The service cannot say, and why.
        """
        return self._ask("index", {}, _INDEX)

    def load(self, version: str) -> dict[str, Any]:
        """Let a version serve until the service ends; returns which, and which one did before.

        Raises:
            ConnectionLostError: No service answers.
            ModelStoreError: The version is refused, and why; the old one serves on.
        """
        return self._ask("load", {"version": version}, VETTING)

    def promote(self, version: str, reason: str) -> dict[str, Any]:
        """Let a version serve, and make it the champion.

        Raises:
            ConnectionLostError, ModelStoreError: As for `load`.
        """
        return self._ask("promote", {"version": version, "reason": reason}, VETTING)

    def rollback(self, reason: str) -> dict[str, Any]:
        """Let the champion before serve again, and make it the champion.

        Raises:
            ConnectionLostError, ModelStoreError: As for `load`, or there is none before.
        """
        return self._ask("rollback", {"reason": reason}, VETTING)

    def retrain(self, reason: str) -> dict[str, Any]:
        """Train a challenger from the newest logs; returns the stage of retraining.

        Raises:
            ConnectionLostError: No service answers.
            ModelStoreError: It does not retrain, or cannot now, and why.
        """
        return self._ask("retrain", {"reason": reason}, _INDEX)

    def _ask(self, verb: str, asked: dict[str, str], timeout: float) -> dict[str, Any]:
        key, arm = self._keys.model(verb), self._keys.arm
        if not self._found():
            raise ConnectionLostError(
                f"no service of arm {arm!r} is on the network; start one with `limo serve`, or say "
                "where it is with `connect` or `config`"
            )
        ends = time.monotonic() + STARTING
        while True:
            for reply in self._session.get(key, payload=to_json(asked), timeout=timeout):
                if reply.ok is not None:
                    return _answer(key, reply.ok.payload.to_bytes())
                if reply.err is not None:
                    raise ModelStoreError(_refusal(key, reply.err.payload.to_bytes(), timeout))
            if time.monotonic() >= ends:  # a service has its name before it can answer
                raise ConnectionLostError(
                    f"the service of arm {arm!r} is on the network, but nobody answered {key} for "
                    f"{STARTING:g} s; it may still be starting, ask again"
                )
            time.sleep(0.1)

    def _found(self) -> bool:
        ends = time.monotonic() + APPEARING
        while not is_alive(self._session, self._keys.alive("service")):
            if time.monotonic() >= ends:
                return False
            time.sleep(0.1)
        return True


def _answer(key: str, payload: bytes) -> dict[str, Any]:
    try:
        answer: object = json.loads(payload)
    except (ValueError, RecursionError):
        answer = None
    if not isinstance(answer, dict):
        raise ModelStoreError(f"{key}: the answer is no JSON object")
    return answer


def _refusal(key: str, payload: bytes, timeout: float) -> str:
    """Return why a service refused; Zenoh itself answers a timeout in plain words."""
    try:
        told: object = json.loads(payload)
    except (ValueError, RecursionError):
        told = None
    if isinstance(told, dict) and isinstance(told.get("error"), str):
        return told["error"]
    return f"{key}: no answer within {timeout:g} s ({payload[:80]!r})"
