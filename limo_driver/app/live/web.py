"""The server of a live page: to this machine alone, the page at `/` and its values at `/live`."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.pages import Page, arm_view
from limo_driver.pages.markup import paragraph
from limo_driver.quoting import in_html
from limo_driver.runtime.processes.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.model import RobotModel

HOST: Final = "127.0.0.1"
RATE: Final = 20.0  # [Hz] of the values
_PLACES = (
    '<section id="arm" class="arm"><div class="stage">'
    '<svg class="leaders" aria-hidden="true"></svg></div></section>'
    '<section><h2>Torque</h2><div id="joints" class="grid three"></div></section>'
    '<section class="grid two"><div><h2>Service</h2><table id="status"></table></div>'
    '<div><h2>Events</h2><ul id="events"></ul></div></section>'
)
_LEAD = (
    "Rings: external torque of each joint, beside the 95 % interval of its estimate. Arrow: the "
    "force at the flange that explains the external torques best. Curves, last 10 s: measured "
    "(grey), estimated with its 95 % interval (blue)."
)


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
    said = '<p id="said" class="sources">waiting for the arm …</p>'
    body = f"<header><h1>{in_html(arm)}</h1>{said}</header>" + paragraph(_LEAD, "lead") + _PLACES
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
