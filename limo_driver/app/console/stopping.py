"""Ctrl-C at any moment of a command: while it imports, while it works, and while it ends.

Imported before anything else of a command, so it imports next to nothing itself.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from _thread import get_ident, start_new_thread
from collections.abc import Iterator
from types import FrameType, TracebackType
from typing import NoReturn, Self

TYPE_CHECKING = False  # as in `typing`, which would have to be imported

_SAID = "limo: interrupted\n"
_PROGRAMS = ("__main__", "runpy")  # where a program begins; `runpy` with `python -m`
_IMPORTING = {"importlib._bootstrap", "_frozen_importlib"}  # the same, before and after it is named
_SOON = 0.01  # [s]


class Stopping:
    """Whether Ctrl-C was pressed, and the one line and exit status that answer it.

    A `KeyboardInterrupt` may come out of an import as another error, may be lost in a callback or
    in the import of a compiled module, and finds nobody to catch it once the main program is over.
    So it is noted, raised again where it was lost, and answered at once when the interpreter is on
    its way out.

    Args:
        status: Exit status of an interrupted command.
    """

    def __init__(self, status: int) -> None:
        self.status = status
        self.asked = False
        self.over = False
        self._lost = sys.unraisablehook
        self._shown = sys.excepthook

    def __enter__(self) -> Self:
        """Listen, unless something else does or Ctrl-C is ignored, as behind `nohup` and `&`."""
        try:
            if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
                signal.signal(signal.SIGINT, self._take)
        except ValueError:  # not the main thread, which alone can listen
            return self
        sys.unraisablehook = self._ask_again
        sys.excepthook = self._ask_again_unseen
        return self

    def __exit__(self, _: object, error: BaseException | None, *_trace: object) -> None:
        self.over = True
        sys.unraisablehook, sys.excepthook = self._lost, self._shown
        if self in sys.meta_path:
            sys.meta_path.remove(self)
        well = error is None or (isinstance(error, SystemExit) and not error.code)
        if self.asked and not well:  # a command that ends well by Ctrl-C says so itself
            sys.stderr.write(_SAID)
            raise SystemExit(self.status) from None

    def find_spec(self, *_: object) -> NoReturn:
        """Refuse the next import, where Ctrl-C came during one that went on regardless."""
        raise KeyboardInterrupt

    def _take(self, _number: int, frame: FrameType | None) -> None:
        modules = list(_modules(frame))
        if not modules or modules[-1] not in _PROGRAMS:  # the interpreter's own code, at its end
            os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, _SAID.encode())
            os._exit(self.status)
        self.asked = True
        if not self.over and not _IMPORTING.isdisjoint(modules) and self not in sys.meta_path:
            sys.meta_path.insert(0, self)
        raise KeyboardInterrupt

    def _ask_again(self, lost: sys.UnraisableHookArgs) -> None:
        if self.asked and issubclass(lost.exc_type, KeyboardInterrupt):
            start_new_thread(_signal_soon, (get_ident(),))  # here it would be lost again
        else:
            self._lost(lost)

    def _ask_again_unseen(
        self, kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:
        """Do the same for what a compiled module prints, and forgets, when it imports another."""
        if self.asked and issubclass(kind, KeyboardInterrupt):
            start_new_thread(_signal_soon, (get_ident(),))
        else:
            self._shown(kind, error, trace)


def _signal_soon(thread: int) -> None:
    time.sleep(_SOON)
    signal.pthread_kill(thread, signal.SIGINT)  # also out of a wait


def _modules(frame: FrameType | None) -> Iterator[str]:
    """Give the modules whose code runs, from the innermost call to the program itself."""
    while frame is not None:
        yield str(frame.f_globals.get("__name__"))
        frame = frame.f_back
