"""`limo watch --web`: what the network says of an arm, fed to a page in a browser.

The feed of a live page: the latest joint state and torque estimate of one arm, as plain values.

Both come at the rate of the robot. The network keeps the newest of each, and they are decoded only
as often as somebody looks.
"""

from __future__ import annotations

import json
import math
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.messages import TorqueEstimate, decode_joint_state, decode_torque_estimate
from limo_driver.pages import Page, arm_view
from limo_driver.pages.markup import paragraph
from limo_driver.pages.motion import stage
from limo_driver.quoting import in_html
from limo_driver.runtime.display import shortened
from limo_driver.runtime.processes import Closing

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh

    from limo_driver.model import RobotModel
    from limo_driver.network.streaming import Keys
    from limo_driver.types import FloatArray

HOST: Final = "127.0.0.1"
RATE: Final = 20.0  # [Hz] of the values
_PLACES = (
    f'<div class="watch"><section id="arm" class="arm" aria-label="The arm">{stage()}</section>'
    '<section class="curves" aria-label="Torque"><div class="controls player">'
    '<button id="pause">Pause</button>'
    '<input id="when" type="range" step="0.05" aria-label="Time that is shown">'
    '<output id="at">live</output><select id="span" aria-label="Time span of the curves">'
    '<option value="10">10 s</option><option value="60">1 min</option>'
    '<option value="600">10 min</option></select></div>'
    '<div id="joints"></div>'
    '<p class="key small"><i class="measured"></i>measured <i class="after"></i>estimated, with its'
    ' 95 % interval <i class="gap"></i>no value <i class="pushed"></i>contact '
    '<i class="swap"></i>other model</p></section>'
    '<section class="facts"><div tabindex="0" role="group" aria-label="Events"><h2>Events</h2>'
    '<ul id="events"></ul></div>'
    '<div tabindex="0" role="group" aria-label="Service"><h2>Service</h2>'
    '<table id="status"></table></div></section></div>'
)
_LEAD = (
    "Rings: external torque of each joint, against the 95 % interval of its estimate; red in a "
    "contact. Arrow: the force at the flange that explains the external torques best then. Neither "
    "tells of motion unlike what was learned, whose external torque is grey. There is no value "
    "where none came, and while the filter of the motion fills after a gap. The last ten minutes "
    "since this page was opened can be looked at: pause, and move the slider."
)
SURE: Final = 1.96  # standard deviations of a 95 % interval
_DAMPING: Final = 0.05  # [m], of the force at the flange in directions that no joint feels well


class LiveServer(Closing):
    """Serves the live page of an arm until it is closed.

    Args:
        arm: Its name on the network.
        model: The robot that is drawn.
        snapshot: Returns what is shown now, as plain values.
        port: 0 for any that is free.

    Raises:
        ConfigError: The port is taken.
    """

    def __init__(
        self, arm: str, model: RobotModel, snapshot: Callable[[], dict[str, Any]], port: int = 0
    ) -> None:
        self._closed = threading.Event()
        self._lock = threading.Lock()
        page = live_page(arm, model).html().encode()

        def values() -> bytes:
            with self._lock:  # nothing is asked for once it was closed
                now = {} if self._closed.is_set() else snapshot()
            return json.dumps(now, allow_nan=False).encode()

        handler = _handler(page, values, self._closed)
        try:
            self._server = ThreadingHTTPServer((HOST, port), handler)
        except OSError as error:
            raise ConfigError(f"port {port} cannot be had: {error.strerror}") from None
        self._server.daemon_threads = True
        self.address = f"http://{HOST}:{self._server.server_port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End all connections; no snapshot is taken from then on."""
        with self._lock:
            self._closed.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def live_page(arm: str, model: RobotModel) -> Page:
    """Return the page that draws an arm as its values come."""
    limits = model.limits
    pose = np.clip(np.zeros(model.n), limits.position_min, limits.position_max)
    text = '<p id="said" class="sources">waiting for the arm …</p>'
    body = f"<header><h1>{in_html(arm)}</h1>{text}</header>{_PLACES}{paragraph(_LEAD, 'lead')}"
    return Page(f"{arm}, live", body, arm=arm_view(model, pose), player="live.js")


def _handler(
    page: bytes, values: Callable[[], bytes], closed: threading.Event
) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        """Answers requests of a browser on this machine."""

        def do_GET(self) -> None:  # the name that http.server calls
            host = self.headers.get("Host", "").rpartition(":")[0]
            if host not in {HOST, "localhost"}:  # a page of elsewhere under a name of its own
                self.send_error(403)
            elif self.path == "/":
                self._begin("text/html; charset=utf-8", len(page))
                self.wfile.write(page)
            elif self.path == "/live":
                self._stream()
            else:
                self.send_error(404)

        def _begin(self, kind: str, length: int | None = None) -> None:
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Cache-Control", "no-store")
            if length is not None:
                self.send_header("Content-Length", str(length))
            self.end_headers()

        def _stream(self) -> None:
            self._begin("text/event-stream")
            try:
                while not closed.wait(1.0 / RATE):
                    self.wfile.write(b"data: " + values() + b"\n\n")
            except (BrokenPipeError, ConnectionResetError):
                return  # who looked is gone

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002  # its name there
            """Say nothing of each request."""
            del format, args

    return Handler


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
                    f"the arm is not drawn: its joints are {shortened(state.names)}, those of "
                    f"{self._model.name} {shortened(drawn)}; name its robot with --robot"
                )
            else:
                self._shown.pop("problem", None)
                self._shown["position"] = _plain(state.position, 5)
                self._shown["stamp"] = state.stamp_ns / 1e9
        if (sample := self._estimates.try_recv()) is not None:
            self._show(decode_torque_estimate(sample.payload.to_bytes()))

    def _show(self, estimate: TorqueEstimate) -> None:
        """Show an estimate; no torque while the filter of the motion fills.

        Physics alone never know their deviation; a model that does not, does not know the rate.
        """
        n, lost = len(estimate.names), estimate.outside & (not estimate.fallback)
        lost = np.full(n, True) if estimate.reset else lost & np.isnan(estimate.std)
        torque, external, std = (
            np.where(lost, np.nan, values) if len(values) == n else values
            for values in (estimate.torque, estimate.external, estimate.std)
        )
        felt = external  # what may be drawn as a touch
        if len(external) == len(estimate.outside):
            felt = np.where(estimate.outside, np.nan, external)
        self._shown |= {
            "estimate_stamp": estimate.stamp_ns / 1e9,
            "names": list(estimate.names),
            "torque": _plain(torque, 4),
            "interval": _plain(SURE * std, 4),
            "external": _plain(external, 4),
            "measured": _plain(torque + external, 4),
            "outside": estimate.outside.tolist(),
            "model": estimate.model,
            "fallback": estimate.fallback,
            "felt": _plain(felt, 4),
            "force": self._force(felt),
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


def _plain(values: FloatArray, digits: int) -> list[float | None]:
    return [round(v, digits) if math.isfinite(v) else None for v in values.tolist()]
