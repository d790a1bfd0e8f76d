"""One line on stderr while a command compiles, and Ctrl-C that ends it there.

The line is rewritten in place on a terminal, and written once elsewhere. Nothing is imported here
that compiles or draws, since every command begins with it.
"""

from __future__ import annotations

import signal
import sys
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from limo_driver.compilation import Compilation, told

if TYPE_CHECKING:
    from collections.abc import Generator

_PATIENCE: Final = 0.3  # [s] of compilation that nobody needs to be told of
_INTERRUPTED: Final = "limo: interrupted while compiling; what is compiled so far is kept"
_CLEAR: Final = "\r\x1b[2K"


@contextmanager
def compilation_line(*, silent: bool = False) -> Generator[None]:
    """Show, inside, how far compilation is, and let Ctrl-C stop it between two of its steps.

    Args:
        silent: Show nothing.
    """
    line, keys = _Line(silent=silent), _Interrupt()

    def pass_on(state: Compilation) -> None:
        keys.follow(state)
        line.follow(state)

    with told(pass_on):
        try:
            yield
        finally:
            line.clear()
            keys.restore()


class _Line:
    """What is seen of a compilation."""

    def __init__(self, *, silent: bool) -> None:
        self._silent = silent
        self._shown = ""  # what stands on the terminal now
        self._said = False

    def follow(self, state: Compilation) -> None:
        if not state.running:
            self.clear()
        elif state.seconds > _PATIENCE and not self._silent:
            self._show(min(state.done + 1, state.most), state.most)

    def _show(self, number: int, most: int) -> None:
        text = f"compiling once on this machine: {number} of up to {most}"
        # Where a progress bar is drawn, stderr is its own, and takes whole lines.
        in_place = sys.stderr.isatty() and not hasattr(sys.stderr, "rich_proxied_file")
        if in_place and text != self._shown:
            _write(f"{_CLEAR}{text}")
            self._shown = text
        elif not in_place and not self._said:
            _write(f"{text}\n")
        self._said = True

    def clear(self) -> None:
        """Leave no trace of the line."""
        if self._shown:
            _write(_CLEAR)
            self._shown = ""


def _write(text: str) -> None:
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except (OSError, ValueError):  # closed, or nobody reads it any more
        pass


class _Interrupt:
    """Ctrl-C while something compiles.

    The compiler calls back into Python from C, where an interrupt would be lost with a traceback,
    so it is raised at the next step of the compiler.
    """

    def __init__(self) -> None:
        self._handler: Any = None  # that was there before
        self._asked = False

    def follow(self, state: Compilation) -> None:
        if threading.current_thread() is not threading.main_thread():
            return
        ours = self._handler is not None
        if state.running and not ours and signal.getsignal(signal.SIGINT) is _DEFAULT:
            self._handler = signal.signal(signal.SIGINT, self._note)
        elif ours and not state.running:
            self.restore()
        if self._asked:
            self._asked = False
            self.restore()
            _write(f"{_INTERRUPTED}\n")
            raise KeyboardInterrupt

    def restore(self) -> None:
        if self._handler is not None:
            signal.signal(signal.SIGINT, self._handler)
            self._handler = None

    def _note(self, *_: object) -> None:
        self._asked = True


_DEFAULT: Final = signal.default_int_handler
