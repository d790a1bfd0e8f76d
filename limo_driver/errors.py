"""Errors of limo: each builds its own message and keeps the facts as attributes.

A message names arguments of the library in backticks; commands call them by their options.

LimoError
├── PlacedError                         knows the file and the line of the mistake
│   ├── ConfigError (ValueError)        a file or option that cannot be used
│   │   └── ParameterError              a value that a parameter cannot have, with what it can
│   └── ModelStoreError                 a model folder that does not fit, by name
├── PlugInError (ImportError)           names the distribution and the entry point
├── MissingPackageError (ImportError)   says what to install
├── HiddenPackageError (ImportError)    names the file that stands where limo's package should
├── BackendError
│   ├── BackendNotFoundError (LookupError)      names the known backends
│   ├── ConnectionLostError (ConnectionError)
│   ├── CycleTimeoutError (TimeoutError)
│   ├── ServiceNotReadyError (TimeoutError)     says who was heard last
│   ├── WireFormatError (ValueError)
│   ├── JointLimitError (ValueError)    a command that no limiter may repair
│   └── HoldingError                    the arm holds; nothing resumes without being told
├── RecordingError (ValueError)         measured data that cannot be used, with the rows
├── PathError
│   └── InfeasiblePathError             names the condition that fails
└── EstimatorError
    ├── NotFittedError
    ├── ShapeError (ValueError)
    └── DivergedError
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from limo_driver.quoting import in_line


class LimoError(Exception):
    """Anything that limo raises on purpose; the facts are attributes of each kind of error.

    Args:
        args: What was given and what was expected, in one sentence.

    Example:
        >>> try:
        ...     limo.Recording.load("run.csv")
        ... except limo.LimoError as error:
        ...     print(error)
    """

    def __init__(self, *args: object) -> None:
        super().__init__(*(in_line(item) if isinstance(item, str) else item for item in args))

    def __reduce__(self) -> tuple[Any, ...]:
        """Say how a pickle makes it anew: by its message and facts, not by its own arguments."""
        return _made_again, (type(self), self.args, vars(self))


def _made_again(
    kind: type[LimoError], args: tuple[object, ...], facts: dict[str, Any]
) -> LimoError:
    error = kind.__new__(kind)
    LimoError.__init__(error, *args)
    vars(error).update(facts)
    return error


class PlacedError(LimoError):
    """Something that cannot be used, with its place in a file where there is one.

    Args:
        message: What was given and what was expected.
        path: File that holds the mistake, if any.
        line: 1-based line of the mistake, if known.
    """

    def __init__(
        self, message: str, *, path: Path | str | None = None, line: int | None = None
    ) -> None:
        self.message, self.path, self.line = message, path, line
        place = "" if path is None else f"{path}: " if line is None else f"{path}, line {line}: "
        super().__init__(place + message)


class ConfigError(PlacedError, ValueError):
    """A configuration that cannot be used."""


class ParameterError(ConfigError):
    """A value that a parameter cannot have.

    Args:
        name: Of the parameter.
        given: What was given, with its unit.
        expected: What it can be, for example `a number above 0 N m`.
        place: What the parameter is of, for example `payload`; empty if nothing needs to be said.
    """

    def __init__(self, name: str, given: str, expected: str, place: str = "") -> None:
        self.name, self.given, self.expected = name, given, expected
        where = f"{place}: " if place else ""
        super().__init__(f"{where}{name} is {given}, expected {expected}")


class PlugInError(LimoError, ImportError):
    """A class that another distribution registers cannot be used.

    Args:
        group: Of entry points, for example `limo.effects`.
        name: Of the entry point.
        target: Module and class that it names.
        distribution: Whose entry point it is.
        reason: Why it cannot be used.
    """

    def __init__(self, group: str, name: str, target: str, distribution: str, reason: str) -> None:
        self.group, self.plug_in, self.target, self.distribution = (
            group,
            name,
            target,
            distribution,
        )
        self.reason = reason
        super().__init__(
            f"entry point `{name} = {target}` in {group} of distribution {distribution} "
            f"cannot be used: {reason}"
        )


class MissingPackageError(LimoError, ImportError):
    """A package that not every installation has is not there.

    Args:
        purpose: What needs it.
        package: As it is imported.
        requirement: What to install, for example `onnx>=1.17`.
    """

    def __init__(self, purpose: str, package: str, requirement: str) -> None:
        self.purpose, self.package, self.requirement = purpose, package, requirement
        super().__init__(
            f"{purpose} needs {package}, which is not installed: pip install '{requirement}'"
        )


class HiddenPackageError(LimoError, ImportError):
    """Another package is imported where one of limo's is meant.

    Args:
        package: Its name, for example `backends`.
        found: File that is imported instead.
    """

    def __init__(self, package: str, found: str) -> None:
        self.package, self.found = package, found
        super().__init__(
            f"`import {package}` finds {found}, which hides limo's package of that name; rename "
            "it, or start Python elsewhere or with -P"
        )


class BackendError(LimoError):
    """A robot backend failed."""


class BackendNotFoundError(BackendError, LookupError):
    """No backend or estimator is registered under this name."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, tuple(sorted(known))
        super().__init__(f"no {kind} is called {name!r}; known: {', '.join(self.known) or 'none'}")


class ConnectionLostError(BackendError, ConnectionError):
    """The robot no longer answers."""


class CycleTimeoutError(BackendError, TimeoutError):
    """No state arrived in time.

    Args:
        waited: How long was waited [s].
    """

    def __init__(self, waited: float) -> None:
        self.waited = waited
        super().__init__(f"no joint state within {waited:.3f} s")


class ServiceNotReadyError(BackendError, TimeoutError):
    """No service got as far as was waited for, in time.

    Args:
        arm: Name of the arm in keys; `*` for any.
        until: How far, for example `serving`.
        waited: How long was waited [s].
        heard: Who was heard last, and what it said; empty if nobody was.
    """

    def __init__(self, arm: str, until: str, waited: float, heard: str) -> None:
        self.arm, self.until, self.waited, self.heard = arm, until, waited, heard
        what = "no service" if arm == "*" else f"no service of arm {arm!r}"
        advice = "start one with `limo serve`, or say where it is with `connect` or `config`"
        super().__init__(
            f"{what} was {until} within {waited:g} s: {heard or f'none was heard; {advice}'}"
        )


class WireFormatError(BackendError, ValueError):
    """Bytes that do not follow the protocol.

    Args:
        message: What was expected.
        offset: Byte offset at which decoding stopped; None where that is not known.
    """

    def __init__(self, message: str, offset: int | None = None) -> None:
        self.offset = offset
        super().__init__(message if offset is None else f"{message} at byte {offset}")


class JointLimitError(BackendError, ValueError):
    """A command that the safety contract refuses.

    Args:
        joint: 1-based joint.
        quantity: What was out of bounds, for example `position`.
        given: The value given, in `unit`.
        bounds: Lower and upper bound, in `unit`.
        unit: SI unit of the value.
        hint: What to do about it.
    """

    def __init__(
        self,
        joint: int,
        quantity: str,
        given: float,
        bounds: tuple[float, float],
        unit: str,
        hint: str = "",
    ) -> None:
        self.joint, self.quantity, self.given, self.bounds, self.unit = (
            joint,
            quantity,
            given,
            bounds,
            unit,
        )
        super().__init__(
            f"joint {joint}: {quantity} {given:.6g} {unit} is outside "
            f"[{bounds[0]:.6g}, {bounds[1]:.6g}] {unit}" + (f"; {hint}" if hint else "")
        )


class HoldingError(BackendError):
    """The arm holds its pose and takes no command until `resume`.

    Args:
        reason: Why it holds.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"the arm holds ({reason}); call resume() before the next command")


class RecordingError(LimoError, ValueError):
    """Measured data that cannot be used.

    Args:
        message: What is wrong and what was expected.
        path: File it came from, if any.
        rows: 0-based rows concerned.
    """

    def __init__(
        self, message: str, *, path: Path | str | None = None, rows: Iterable[int] = ()
    ) -> None:
        self.message, self.path, self.rows = message, path, tuple(rows)
        super().__init__(message if path is None else f"{path}: {message}")


class PathError(LimoError):
    """A path that cannot be planned or followed."""


class InfeasiblePathError(PathError):
    """No path satisfies the request.

    Args:
        condition: The condition that fails, for example `effective workspace`.
        message: Figures that show it.
    """

    def __init__(self, condition: str, message: str) -> None:
        self.condition = condition
        super().__init__(f"{condition}: {message}")


class EstimatorError(LimoError):
    """A torque estimator failed."""


class NotFittedError(EstimatorError):
    """`fit` has not been called.

    Args:
        estimator: Name of the estimator.
    """

    def __init__(self, estimator: str) -> None:
        self.estimator = estimator
        super().__init__(f"{estimator} is not fitted; call fit() or load a model first")


class ShapeError(EstimatorError, ValueError):
    """An array of the wrong shape.

    Args:
        name: Name of the argument.
        given: Shape given.
        expected: Shape expected, in shape letters, for example `(T, 7)`.
    """

    def __init__(self, name: str, given: tuple[int, ...], expected: str) -> None:
        self.name, self.given, self.expected = name, given, expected
        super().__init__(f"{name} has shape {given}, expected {expected}")


class DivergedError(EstimatorError):
    """Training or estimation left the finite numbers."""


class ModelStoreError(PlacedError):
    """A model folder that cannot be used, with the reason."""
