"""The feed of a live page: the latest joint state and torque estimate of one arm, as plain values.

Both come at the rate of the robot. The network keeps the newest of each, and they are decoded only
as often as somebody looks.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.errors import WireFormatError
from limo_driver.network.messages import decode_joint_state, decode_torque_estimate
from limo_driver.runtime.processes.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import zenoh

    from limo_driver.model import RobotModel
    from limo_driver.network.streaming import Keys
    from limo_driver.types import FloatArray

SURE: Final = 1.96  # standard deviations of a 95 % interval
_NAMED: Final = 8  # joints, in a sentence
_DAMPING: Final = 0.05  # [m], of the force at the flange in directions that no joint feels well


class ArmFeed(Closing):
    """Follows one arm on the network.

    Args:
        session: Open Zenoh session.
        keys: Of the arm.
        model: The robot that is drawn; its joints are those of the stream.
        said: Returns status and events of the arm as plain values, as they are known.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        model: RobotModel,
        said: Callable[[], dict[str, Any]],
    ) -> None:
        import zenoh

        newest = zenoh.handlers.RingChannel(1)
        self._followed = [session.declare_subscriber(keys.joints, newest)]
        self._followed.append(session.declare_subscriber(keys.estimate, newest))
        self._states, self._estimates = (each.handler for each in self._followed)
        self._model, self._said = model, said
        self._shown: dict[str, Any] = {}
        self._came = -math.inf

    def snapshot(self) -> dict[str, Any]:
        """Return what is known now; NaN, and what never came, as None."""
        try:
            self._take()
        except WireFormatError as error:
            self._shown["problem"] = str(error)
        age = time.monotonic() - self._came
        return {**self._shown, **self._said(), "age": round(age, 2) if age < math.inf else None}

    def close(self) -> None:
        """Stop following."""
        while self._followed:
            self._followed.pop().undeclare()

    def _take(self) -> None:
        if (sample := self._states.try_recv()) is not None:
            state = decode_joint_state(sample.payload.to_bytes())
            self._came = time.monotonic()
            drawn = self._model.joint_names
            self._shown["drawn"] = state.names == drawn and len(state.position) == len(drawn)
            if not self._shown["drawn"]:
                self._shown.pop("position", None)
                self._shown["problem"] = (
                    f"the arm is not drawn: its joints are {_listed(state.names)}, those of "
                    f"{self._model.name} {_listed(drawn)}; name its robot with --robot"
                )
            else:
                self._shown.pop("problem", None)
                self._shown["position"] = _plain(state.position, 5)
                self._shown["stamp"] = state.stamp_ns / 1e9
        if (sample := self._estimates.try_recv()) is not None:
            estimate = decode_torque_estimate(sample.payload.to_bytes())
            self._shown |= {
                "estimate_stamp": estimate.stamp_ns / 1e9,
                "torque": _plain(estimate.torque, 4),
                "interval": _plain(SURE * estimate.std, 4),
                "external": _plain(estimate.external, 4),
                "measured": _plain(estimate.torque + estimate.external, 4),
                "outside": estimate.outside.tolist(),
                "model": estimate.model,
                "fallback": estimate.fallback,
                "force": self._force(estimate.external),
            }

    def _force(self, external: FloatArray) -> list[float | None] | None:
        """Return the force on the flange that explains external torques best, (3,) [N].

        An external torque is -Jᵀ F; of moments nothing is said.
        """
        position = self._shown.get("position")
        if position is None or len(external) != self._model.n or not np.isfinite(external).all():
            return None
        J = self._model.flange_jacobian(np.array(position, dtype=float))[:3]
        force = np.linalg.solve(J @ J.T + _DAMPING**2 * np.eye(3), -J @ external)
        return _plain(np.asarray(force, dtype=np.float64), 2)


def _listed(names: Sequence[str]) -> str:
    """Return names in a sentence, the first few of them."""
    more = f", ... ({len(names)} in all)" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more if names else "none"


def _plain(values: FloatArray, digits: int) -> list[float | None]:
    return [round(v, digits) if math.isfinite(v) else None for v in values.tolist()]
