"""A headless Chromium, driven over its own protocol: for tests of pages, and for pictures of them.

It has a user folder of its own, reaches no network that a page does not ask for, and waits for
what a page says of itself, never for time.
"""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
from contextlib import contextmanager
from dataclasses import dataclass, field
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from urllib.request import urlopen

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence
    from pathlib import Path

    from websockets.sync.client import ClientConnection

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
LONGEST = 60.0  # [s] until a browser that says nothing is given up
_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--remote-debugging-port=0", "--remote-allow-origins=*", "--hide-scrollbars",
)  # fmt: skip


def program() -> str | None:
    """Return the browser of this machine, if it has one."""
    return installed(PROGRAMS)


def installed(names: Sequence[str]) -> str | None:
    """Return the first of some programs that this machine has."""
    return next((found for name in names if (found := shutil.which(name))), None)


@dataclass
class Tab:
    """One page of a browser."""

    socket: ClientConnection
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
            if said.get("method") == "Runtime.exceptionThrown":
                details = said["params"]["exceptionDetails"]
                self.errors.append(details.get("exception", {}).get("description", str(details)))
            if said.get("id") == self._asked:
                if "error" in said:
                    raise RuntimeError(f"{method}: {said['error']}")
                return said["result"]

    def look(self, url: str, width: int = 1400, height: int = 900, *, dark: bool = False) -> None:
        """Open a page in a window of some size and wait until it is loaded."""
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height,
                 deviceScaleFactor=1, mobile=width < 600)  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.ask("Emulation.setEmulatedMedia", features=[scheme])
        self.ask("Page.enable")
        self.ask("Runtime.enable")
        self.ask("Page.navigate", url=url)
        self.wait("document.readyState === 'complete' && location.href !== 'about:blank'")

    def value(self, script: str) -> Any:  # noqa: ANN401  # JSON
        """Return what an expression is in the page; of a promise, what it resolves to.

        Raises:
            RuntimeError: It throws.
        """
        done = self.ask(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in done:
            raise RuntimeError(str(done["exceptionDetails"]))
        return done["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until a condition of the page holds, looked at before each frame that it draws."""
        self.value(until(condition))

    def picture(self, path: Path, *, whole: bool = False) -> None:
        """Write what is seen, or the whole page, as PNG."""
        done = self.ask("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(done["data"]))

    def paper(self, path: Path) -> None:
        """Write the page as it is printed, as PDF."""
        done = self.ask("Page.printToPDF", printBackground=True, preferCSSPageSize=True)
        path.write_bytes(base64.b64decode(done["data"]))


@contextmanager
def browser() -> Generator[Tab]:
    """Start a browser, and end it.

    Raises:
        RuntimeError: There is none on this machine, or it does not start.
    """
    from websockets.sync.client import connect

    found = program()
    if found is None:
        raise RuntimeError(f"no browser is installed, expected one of {', '.join(PROGRAMS)}")
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [found, *_FLAGS, f"--user-data-dir={folder}", "about:blank"]
        with (
            running(command) as process,
            connect(_page_of(process), max_size=None, open_timeout=LONGEST) as socket,
        ):
            yield Tab(socket)


@contextmanager
def running(command: Sequence[str]) -> Generator[subprocess.Popen[str]]:
    """Start a browser whose standard error says where it listens, and end it."""
    process = subprocess.Popen(  # noqa: S603  # a browser, with a page of ours
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait()
        if process.stderr:
            process.stderr.close()


def until(condition: str) -> str:
    """Return the script of a promise that a condition of the page holds."""
    return (
        "new Promise((done) => { const look = () => { let holds = false; "
        f"try {{ holds = Boolean({condition}); }} catch {{ }} "
        "holds ? done(true) : setTimeout(look, 20); }; look(); })"
    )


def _page_of(process: subprocess.Popen[str]) -> str:
    """Return the address of a browser's first page, once it says where it listens."""
    for line in process.stderr or ():
        if "DevTools listening on" in line:
            host = line.split("ws://")[1].split("/")[0]
            with urlopen(f"http://{host}/json/list", timeout=LONGEST) as answer:
                pages = json.load(answer)
            return next(p["webSocketDebuggerUrl"] for p in pages if p["type"] == "page")
    raise RuntimeError("the browser ended before it listened")
