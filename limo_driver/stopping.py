"""Ctrl-C at any moment of a command: while it imports, while it works, and while it ends.

Imported before anything else of a command, so it imports next to nothing itself.
"""

from __future__ import annotations

import os
import signal
import sys
from _thread import interrupt_main
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import FrameType, TracebackType
    from typing import Self

_SAID = "limo: interrupted\n"
_PROGRAMS = ("__main__", "runpy")  # where a program begins; `runpy` with `python -m`


class Stopping:
    """Whether Ctrl-C was pressed, and the one line and exit status that answer it.

    A `KeyboardInterrupt` may come out of an import as another error, may be lost in a callback that
    cannot raise, and finds nobody to catch it once the main program is over. So it is noted, asked
    for again where it was lost, and answered at once when the interpreter is on its way out.

    Args:
        status: Exit status of an interrupted command.
    """

    def __init__(self, status: int) -> None:
        self.status = status
        self.asked = False
        self._lost = sys.unraisablehook

    def __enter__(self) -> Self:
        """Listen, unless something else does or Ctrl-C is ignored, as behind `nohup` and `&`."""
        try:
            if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
                signal.signal(signal.SIGINT, self._take)
        except ValueError:  # not the main thread, which alone can listen
            return self
        sys.unraisablehook = self._ask_again
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        sys.unraisablehook = self._lost
        well = error is None or (isinstance(error, SystemExit) and not error.code)
        if self.asked and not well:  # a command that ends well by Ctrl-C says so itself
            sys.stderr.write(_SAID)
            raise SystemExit(self.status) from None

    def _take(self, _number: int, frame: FrameType | None) -> None:
        if not _in_program(frame):
            os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, _SAID.encode())
            os._exit(self.status)
        self.asked = True
        raise KeyboardInterrupt

    def _ask_again(self, lost: sys.UnraisableHookArgs) -> None:
        if self.asked and issubclass(lost.exc_type, KeyboardInterrupt):
            interrupt_main()
        else:
            self._lost(lost)


def _in_program(frame: FrameType | None) -> bool:
    """Say whether the main program still runs; afterwards, only the interpreter's own code does."""
    while frame is not None and frame.f_back is not None:
        frame = frame.f_back
    return frame is not None and frame.f_globals.get("__name__") in _PROGRAMS
