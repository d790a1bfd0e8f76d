"""Where a proposed mapping is written: never over one that somebody may have answered in."""

from __future__ import annotations

from dataclasses import dataclass, fields
from hashlib import sha256
from typing import TYPE_CHECKING, Final

from limo_driver.errors import ConfigError, LimoError
from limo_driver.logs.readers.columns.names import NO_COLUMN
from limo_driver.logs.readers.mapping import QUANTITIES, Channels, LogMapping, TimeColumns
from limo_driver.runtime.display import shortened, spanned
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.logs.readers.inspection import Inspection

_PARTS: Final = ("time", *QUANTITIES)
_LISTED: Final = 8
_MARK: Final = "# as proposed: "
_DIGITS: Final = 16


@dataclass(frozen=True)
class Settled:
    """Which file reads the log."""

    path: Path
    mapping: LogMapping  # that stands there
    is_kept: bool  # it was there, and reads otherwise than what is proposed
    told: tuple[str, ...]


def settle(found: Inspection, out: Path, log: str) -> Settled:
    """Write a proposed mapping, unless one is there that is of this log and reads otherwise.

    One that is of another log, or cannot be read as a mapping, stays too; the proposal is then
    written beside it, to a file named after the log.

    Args:
        found: What was proposed.
        out: Where to write it.
        log: Name of the log, without its ending.

    Raises:
        ConfigError: Both files are there, and neither is of this log; or it cannot be written.
    """
    told: list[str] = []
    text = _marked(found.mapping.as_file)
    for path in (out, out.with_name(f"{log}.{out.stem}.yaml")):
        there = None if path.exists() else found.mapping
        try:
            there = there or LogMapping.load(path)
            _check_of(there, found)
        except LimoError as error:
            reason = str(error).removeprefix(f"{path}: ").removeprefix(f"{path}, ")
            told.append(f"kept {path}, which is no mapping of this log: {reason}")
            continue
        if not path.exists() or _is_open_still(path, there) or path.read_bytes() == text.encode():
            with whole(path) as draft:
                draft.write_text(text, encoding="utf-8")
            return Settled(path, found.mapping, False, (*told, f"wrote {path}"))
        told.append(
            f"kept {path}, which is there and reads otherwise{_difference(there, found.mapping)}; "
            "to see what is proposed now, name another file by `out`"
        )
        return Settled(path, there, True, tuple(told))
    raise ConfigError(f"{'; '.join(told)}; name another file by `out`")


def _marked(text: str) -> str:
    """Return the text of a proposal with a mark by which a later change is seen."""
    return f"{text}{_MARK}{sha256(text.encode()).hexdigest()[:_DIGITS]}\n"


def _is_open_still(path: Path, mapping: LogMapping) -> bool:
    """Say whether a file is a proposal that nobody has answered in, and that cannot be used so."""
    text = path.read_text(encoding="utf-8")
    return bool(mapping.undecided) and text == _marked(text.rpartition(_MARK)[0])


def _check_of(mapping: LogMapping, found: Inspection) -> None:
    """Check that a mapping may be of a log.

    Raises:
        ConfigError: It is of other joints, or reads columns that are not there.
    """
    model = found.proposal.model
    known = {*model.joint_names, *model.description.locked}
    if other := [name for name in mapping.joints if name not in known]:
        raise ConfigError(f"it is of the joints {shortened(other)}, not of {model.name}")
    there = {*found.table.columns, *found.table.unread, NO_COLUMN}
    parts = (getattr(mapping, quantity) for quantity in _PARTS)
    lacking = [name for part in parts if part for name in part.columns if name not in there]
    if lacking:
        raise ConfigError(f"it reads {shortened(lacking)}, and the log has no such columns")


def _difference(there: LogMapping, proposed: LogMapping) -> str:
    """Say in which quantities two mappings differ; nothing where they read alike."""
    told: list[str] = []
    for quantity in _PARTS:
        one, other = getattr(there, quantity), getattr(proposed, quantity)
        if one == other:
            continue
        if one is None or other is None:
            told.append(f"{'no ' if one is None else ''}{quantity}")
            continue
        told += [
            f"{quantity} has {item.name} {_said(one, item.name)}, not {_said(other, item.name)}"
            for item in fields(one)
            if getattr(one, item.name) != getattr(other, item.name)
        ]
    return f" ({shortened(told, _LISTED)})" if told else ""


def _said(part: Channels | TimeColumns, name: str) -> str:
    value = getattr(part, name)
    if not isinstance(value, tuple):
        return str(value)
    return str(value[0]) if len(set(value)) == 1 else spanned(list(map(str, value)))
