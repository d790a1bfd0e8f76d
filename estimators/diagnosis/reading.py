"""Reading a verdict back from the `verdict.json` of a diagnosis."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from types import UnionType
from typing import TYPE_CHECKING, Any, get_args, get_origin, get_type_hints

from estimators.diagnosis import verdict as values
from estimators.diagnosis.verdict import SCHEMA, VERDICT, Verdict
from limo_driver.errors import ConfigError
from limo_driver.runtime import written_by
from limo_driver.runtime.given_files import read_json_file

if TYPE_CHECKING:
    from pathlib import Path


def verdict_in(folder: Path) -> Verdict:
    """Return the verdict of a diagnosis that was saved.

    Args:
        folder: Of the diagnosis.

    Raises:
        ConfigError: There is no verdict.json, or not one that this version wrote.
    """
    path = folder / VERDICT
    content: Any = read_json_file(path, ConfigError)
    advice = written_by.advice_to_update(written_by.writer_of(content))
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise ConfigError(f"is no verdict of schema {SCHEMA}{advice}", path=path)
    try:
        return _made(Verdict, content)
    except (KeyError, TypeError) as error:
        raise ConfigError(f"cannot be read as a verdict: {error}{advice}", path=path) from None


def _made(kind: type[Any], content: dict[str, Any]) -> Any:  # noqa: ANN401  # one of the dataclasses
    hints = get_type_hints(kind, vars(values) | {"Mapping": dict})
    names = {item.name for item in fields(kind)}
    given = {k: _value(hints[k], v) for k, v in content.items() if k in names}
    return kind(**given)


def _value(hint: Any, value: Any) -> Any:  # noqa: ANN401  # JSON
    """Return a value of JSON as the field of a dataclass has it."""
    if value is None:
        return float("nan") if hint is float else None
    if get_origin(hint) is UnionType:
        hint = next(item for item in get_args(hint) if item is not type(None))
    if is_dataclass(hint) and isinstance(hint, type):
        return _made(hint, value)
    if isinstance(value, list):
        inner = get_args(hint)
        of = inner[0] if get_origin(hint) is tuple and len(inner) > 1 and inner[1] is ... else None
        return tuple(_value(of, item) for item in value)
    if isinstance(value, dict):
        inner = get_args(hint)
        return {k: _value(inner[1] if len(inner) > 1 else None, v) for k, v in value.items()}
    return value
