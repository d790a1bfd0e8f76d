"""One line on stderr while a command compiles.

The line is rewritten in place on a terminal, and written once elsewhere. Nothing is imported here
that compiles or draws, since every command begins with it.
"""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from limo_driver.runtime.machine_code.compilation import Compilation, told

if TYPE_CHECKING:
    from collections.abc import Generator

_PATIENCE: Final = 0.3  # [s] of compilation that nobody needs to be told of
_CLEAR: Final = "\r\x1b[2K"


@contextmanager
def compilation_line(*, silent: bool = False) -> Generator[None]:
    """Show, inside, how far compilation is.

    Args:
        silent: Show nothing.
    """
    line = _Line(silent=silent)
    with told(line.follow):
        try:
            yield
        finally:
            line.clear()


class _Line:
    """Progress line of a compilation."""

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
