"""Functions that numba compiles at their first call, and whose machine code is kept.

`compiled` stands for `numba.njit(cache=True)`, whose cache runs old machine code after a change in
a file that a function calls into, and falls over half-written files and folders that cannot be
written. Here the name of a file holds a digest of all that its code comes from: the byte code of
the function and of every compiled function that it reaches, the values of the constants they use,
and the versions of the compiler. What cannot be read is compiled anew; what cannot be kept is
compiled in every process.

All that limo knows about the inside of numba stands in this file.
"""

# pyright: reportPrivateUsage=false, reportAttributeAccessIssue=false, reportCallIssue=false
# pyright: reportUnnecessaryIsInstance=false, reportOptionalSubscript=false, reportReturnType=false
# pyright: reportArgumentType=false
from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, Final, TypeVar

import numba
from numba.core import event, sigutils
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

from limo_driver.runtime import compilation, machine_code
from limo_driver.runtime.machine_code import digest, reached

_Function = TypeVar("_Function", bound="Callable[..., Any]")

_functions: Final[list[Dispatcher]] = []  # all that `compiled` made, in the order of import


def compiled(
    *,
    reads: tuple[str, ...] = (),
    **options: Any,  # noqa: ANN401  # numba's
) -> Callable[[_Function], _Function]:
    """Compile a function at its first call, once on this machine.

    Numba gives a function without `fastmath` that of whoever has it compiled first, and its sums
    would then depend on what else ran in the process; here it has none.

    A small function that only compiled functions call compiles fastest with `inline="always"`,
    which writes it into each of them.

    Args:
        reads: Parameters whose arrays may be read-only or not. Both are types of their own to
            numba; for these, one is compiled, which takes either.
        options: Of `numba.njit`, for example `nogil` and `fastmath`.
    """

    def wrap(function: _Function) -> _Function:
        dispatcher = numba.njit(**({"fastmath": False} | options))(function)
        if isinstance(dispatcher, Dispatcher):  # else numba is switched off
            dispatcher._cache = _MachineCode(dispatcher)
            _release_after_compiling(dispatcher)
            if reads:
                _take_read_only(dispatcher, reads)
            _functions.append(dispatcher)
        return dispatcher

    return wrap


def _release_after_compiling(dispatcher: Dispatcher) -> None:
    """Let other processes go on once a function was compiled, or could not be."""
    compile_and_keep = dispatcher.compile

    def compile_one(sig: Any) -> Any:  # noqa: ANN401
        try:
            return compile_and_keep(sig)
        finally:
            dispatcher._cache.release()

    dispatcher.compile = compile_one


def _take_read_only(dispatcher: Dispatcher, reads: tuple[str, ...]) -> None:
    """Have a function compiled for read-only arrays alone where it only reads them."""
    names = list(dispatcher.py_func.__code__.co_varnames)
    places = {names.index(name) for name in reads}
    compile_as_asked = dispatcher.compile
    # What numba finds at once. Two equal entries would be ambiguous to it: it would ask for every
    # call again, a hundred times slower, and two threads may ask at the same time.
    known: set[tuple[int, ...]] = set()
    one_at_a_time = threading.Lock()

    def compile_one(sig: Any) -> Any:  # noqa: ANN401
        asked, _ = sigutils.normalize_signature(sig)
        taken = tuple(
            each.copy(readonly=True) if k in places and each.mutable else each
            for k, each in enumerate(asked)
        )
        entry = compile_as_asked(taken)
        codes = tuple(each._code for each in asked)
        with one_at_a_time:
            if taken != asked and codes not in known:  # as if it had been compiled for these
                dispatcher._insert(list(codes), entry, False)
                known.add(codes)
        return entry

    dispatcher.compile = compile_one


def signatures() -> dict[str, int]:
    """Return how many signatures each compiled function has been asked for in this process."""
    return {_name(function): len(function.overloads) for function in _functions}


def _name(dispatcher: Dispatcher) -> str:
    return f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}"


class _MachineCode:
    """The machine code of one function; what a dispatcher of numba asks a cache for."""

    def __init__(self, dispatcher: Dispatcher) -> None:
        self._dispatcher = dispatcher
        self._place: machine_code.CodePlace | None = None
        self._own = threading.local()  # `claims` of a thread
        self.cache_path = None  # numba's statistics ask for it

    def is_kept(self) -> bool:
        """Say whether there is code of any signature."""
        return self.place().any()

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:  # noqa: ANN401
        """Return the kept code of a signature, or None: then this process is to compile it.

        What another process compiles at this moment is waited for.
        """
        target_context.refresh()
        self._place = None  # a constant may have another value than when it was asked for
        place, key = self.place(), _key(sig, target_context.codegen())
        found = _rebuilt(place.read(key), target_context)
        if found is None:
            with _watch.waiting(self._dispatcher) as tick:
                claim = place.claim(key, tick)
            if claim is not None:
                self._own.claims = [*getattr(self._own, "claims", ()), claim]
                found = _rebuilt(place.read(key), target_context)
        return found

    def release(self) -> None:
        """Let the processes go on that wait for what this one was to compile."""
        claims, self._own.claims = getattr(self._own, "claims", ()), []
        for claim in claims:
            claim.release()

    def save_overload(self, sig: Any, data: CompileResult) -> None:  # noqa: ANN401
        """Keep the code of a signature, if that can be done."""
        if data.library.has_dynamic_globals or any(not x.can_cache for x in data.lifted):
            return  # it holds addresses of this process
        self._place = None
        self.place().write(_key(sig, data.codegen), lambda: dumps(data._reduce()))

    def place(self) -> machine_code.CodePlace:
        """Return where the code is kept, for the function and the values it uses now."""
        if self._place is None:
            source = self._dispatcher.py_func.__code__.co_filename
            name, made_from = _name(self._dispatcher), digest(self._dispatcher)
            self._place = machine_code.CodePlace(source, name, made_from)
        return self._place

    def flush(self) -> None:
        """Do nothing: files are named by their content."""

    def enable(self) -> None:
        """Keep code, as always."""

    disable = enable


def _rebuilt(kept: Any, target_context: Any) -> CompileResult | None:  # noqa: ANN401
    try:
        return None if kept is None else CompileResult._rebuild(target_context, *kept)
    except Exception:  # noqa: BLE001  # whatever is wrong with it, it can be compiled
        return None


def _key(sig: Any, codegen: Any) -> str:  # noqa: ANN401
    """Return a key that differs for different signatures and processors."""
    return repr((sig, codegen.magic_tuple()))


class _Watch(event.Listener):
    """Tells `compilation` what numba compiles. Numba compiles one function at a time."""

    def __init__(self) -> None:
        self._under_way: list[Dispatcher] = []
        self._done = self._most = 0
        self._before, self._begun = 0.0, 0.0  # [s]

    def on_start(self, event: event.Event) -> None:
        self._begin(event.data["dispatcher"])
        self._tell()

    def on_end(self, event: event.Event) -> None:
        if self._end() in _functions:
            self._done += 1
        self._tell(event.data["dispatcher"])

    @contextmanager
    def waiting(self, dispatcher: Dispatcher) -> Generator[Callable[[], None]]:
        """Count the time inside as spent on a function, and tell it as often as it is called."""
        told = False

        def tick() -> None:
            nonlocal told
            if not told:
                self._begin(dispatcher)
            told = True
            self._tell()

        try:
            yield tick
        finally:
            if told:
                self._end()
                self._tell(dispatcher)

    def _begin(self, dispatcher: Dispatcher) -> None:
        if not self._under_way:
            self._begun = time.monotonic()
            self._most = max(self._most, self._done + _pending())
        self._under_way.append(dispatcher)

    def _end(self) -> Dispatcher:
        ended = self._under_way.pop()
        if not self._under_way:
            self._before += time.monotonic() - self._begun
        return ended

    def tick(self) -> None:
        """Tell the same once more, inside a function that takes long."""
        if self._under_way:
            self._tell()

    def _tell(self, last: Dispatcher | None = None) -> None:
        running = bool(self._under_way)
        seconds = self._before + (time.monotonic() - self._begun if running else 0.0)
        name = _name(self._under_way[0] if running else last)
        most = max(self._most, self._done + running)
        compilation.tell(compilation.Compilation(name, running, self._done, most, seconds))


class _Ticks(event.Listener):
    """Passes of the compiler: the only sign of life inside a function that takes long."""

    def on_start(self, event: event.Event) -> None:  # noqa: ARG002
        _watch.tick()

    def on_end(self, event: event.Event) -> None:
        pass


def _pending() -> int:
    """Return how many functions that are imported would have to be compiled before their use."""
    fresh = [f for f in _functions if not f.overloads and "inline" not in f.targetoptions]
    missing = {f for f in fresh if not f._cache.is_kept()}
    behind = {inner for f in missing for inner in reached(f) if not inner.overloads}
    return len(missing | (behind & set(fresh)))


_watch: Final = _Watch()
event.register("numba:compile", _watch)
event.register("numba:run_pass", _Ticks())
