"""A headless Firefox, driven over WebDriver BiDi: pages have to work in it as in Chromium."""

from __future__ import annotations

import base64
import json
import re
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from browser import installed, running, until

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Generator

    from websockets.sync.client import ClientConnection

PROGRAMS = ("firefox-esr", "firefox")
LONGEST = 90.0  # [s] until a browser that says nothing is given up
# Machines without a screen draw in software, as far as they have what that needs.
_PREFERENCES = {"webgl.force-enabled": True, "datareporting.policy.dataSubmissionEnabled": False}


def program() -> str | None:
    """Return the Firefox of this machine, if it has one."""
    return installed(PROGRAMS)


@dataclass
class FirefoxTab:
    """One page of a Firefox."""

    socket: ClientConnection
    context: str = ""
    errors: list[str] = field(default_factory=list)  # exceptions of the page's scripts
    _asked: int = 0

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:  # noqa: ANN401  # JSON
        """Send a command of the protocol and return its answer.

        Raises:
            RuntimeError: The browser refuses it.
        """
        self._asked += 1
        self.socket.send(json.dumps({"id": self._asked, "method": method, "params": parameters}))
        while True:
            said = json.loads(self.socket.recv(timeout=LONGEST))
            if said.get("method") == "log.entryAdded" and said["params"]["level"] == "error":
                self.errors.append(said["params"]["text"])
            if said.get("id") == self._asked:
                if said["type"] == "error":
                    raise RuntimeError(f"{method}: {said['message']}")
                return said["result"]

    def look(self, url: str, width: int = 1400, height: int = 900) -> None:
        """Open a page in a window of some size and wait until it is loaded."""
        if not self.context:
            self.ask("session.new", capabilities={})
            self.ask("session.subscribe", events=["log.entryAdded"])
            tree = self.ask("browsingContext.getTree", maxDepth=0)
            self.context = tree["contexts"][0]["context"]
        size = {"width": width, "height": height}
        self.ask("browsingContext.setViewport", context=self.context, viewport=size)
        self.ask("browsingContext.navigate", context=self.context, url=url, wait="complete")

    def value(self, script: str) -> Any:  # noqa: ANN401  # JSON
        """Return what an expression is in the page; of a promise, what it resolves to.

        Raises:
            RuntimeError: It throws.
        """
        done = self.ask(
            "script.evaluate",
            expression=f"Promise.resolve({script}).then((said) => JSON.stringify(said ?? null))",
            target={"context": self.context},
            awaitPromise=True,
        )
        if done["type"] == "exception":
            raise RuntimeError(done["exceptionDetails"]["text"])
        return json.loads(done["result"]["value"])

    def wait(self, condition: str) -> None:
        """Wait until a condition of the page holds."""
        self.value(until(condition))

    def picture(self, path: Path) -> None:
        """Write the whole page as PNG."""
        done = self.ask(
            "browsingContext.captureScreenshot", context=self.context, origin="document"
        )
        path.write_bytes(base64.b64decode(done["data"]))


@contextmanager
def firefox() -> Generator[FirefoxTab]:
    """Start a Firefox with a profile of its own, and end it.

    Raises:
        RuntimeError: There is none on this machine, or it does not start.
    """
    from websockets.sync.client import connect

    found = program()
    if found is None:
        raise RuntimeError(f"no Firefox is installed, expected one of {', '.join(PROGRAMS)}")
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        lines = (f"user_pref({json.dumps(k)}, {json.dumps(v)});" for k, v in _PREFERENCES.items())
        (Path(folder) / "user.js").write_text("\n".join(lines), encoding="utf-8")
        command = [found, "--headless", "--no-remote", "--profile", folder]
        with (
            running([*command, "--remote-debugging-port", "0"]) as process,
            connect(f"{_address(process)}/session", max_size=None, open_timeout=LONGEST) as socket,
        ):
            yield FirefoxTab(socket)


def _address(process: subprocess.Popen[str]) -> str:
    """Return where a browser listens, once it says so."""
    for line in process.stderr or ():
        if found := re.search(r"WebDriver BiDi listening on (ws://\S+)", line):
            return found[1]
    raise RuntimeError("the browser ended before it listened")
