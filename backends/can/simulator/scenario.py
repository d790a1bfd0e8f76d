"""Scenario files: what goes wrong, and when.

```yaml
seed: 1
faults:
  - {fault: lose_frames, probability: 0.01, way: from_drives}
  - {fault: drive_fault, joint: 3, at: 2.5, code: 0x4310}
```
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import yaml

from backends.can.entries import REAL, WHOLE
from backends.can.simulator.faults import KINDS, Fault
from limo_driver.errors import ConfigError
from limo_driver.yaml_reader import YamlReader

if TYPE_CHECKING:
    from collections.abc import Sequence

    from backends.can.config import Joint


@dataclass(frozen=True)
class Scenario:
    """Faults, and the seed of their chances."""

    faults: tuple[Fault, ...] = ()
    seed: int = 0

    @classmethod
    def load(cls, path: Path | str, joints: Sequence[Joint]) -> Scenario:
        """Read a scenario for an arm.

        Raises:
            ConfigError: Names the line, what was given and what exists.
        """
        return _Reader(Path(path), joints).scenario()


class _Reader(YamlReader):
    """Makes a scenario of the nodes of one file."""

    def __init__(self, path: Path, joints: Sequence[Joint]) -> None:
        super().__init__(path)
        self._joints = joints

    def scenario(self) -> Scenario:
        if self.root is None:
            raise ConfigError("is empty; it needs `faults:`", path=self.path)
        given = self._mapping(self.root, "the file", ("seed", "faults"))
        if "faults" not in given:
            self._fail(self.root, "lacks `faults:`, a list of `- {fault: ..., at: ...}`")
        seed = self._whole(given["seed"]) if "seed" in given else 0
        if seed < 0:
            self._fail(given["seed"], f"seed is {seed}, expected at least 0")
        listed = given["faults"]
        if not isinstance(listed, yaml.SequenceNode):
            self._fail(listed, "faults: has to be a list of `- {fault: ..., at: ...}`")
        return Scenario(tuple(self._fault(node) for node in listed.value), seed)

    def _fault(self, node: yaml.Node) -> Fault:
        given = self._mapping(node, "a fault", None)
        if "fault" not in given:
            self._fail(node, f"lacks `fault:`, one of {', '.join(KINDS)}")
        named = given.pop("fault")
        if (name := self._text(named)) not in KINDS:
            self._fail(named, f"fault {name!r} is unknown; known: {', '.join(KINDS)}")
        kind = KINDS[name]
        entries = {item.name: item for item in fields(kind)}
        self._mapping(node, name, ("fault", *entries))
        missing = [k for k, item in entries.items() if item.default is MISSING and k not in given]
        if missing:
            self._fail(node, f"{name} lacks {', '.join(missing)}")
        values = {
            key: self._value(value, entries[key].metadata["kind"]) for key, value in given.items()
        }
        return self._made(node, kind, given, values)

    def _value(self, node: yaml.Node, kind: str) -> float | str:
        if kind == WHOLE:
            return self._whole(node)
        return self._number(node) if kind == REAL else self._text(node)

    def _made(
        self,
        node: yaml.Node,
        kind: type[Fault],
        given: dict[str, yaml.Node],
        values: dict[str, float | str],
    ) -> Fault:
        try:
            fault = cast("Any", kind)(**values)
            fault.check(self._joints)
        except ConfigError as error:
            # The message begins with the name of the entry that is wrong.
            name = str(error).split(maxsplit=1)[0]
            self._fail(given.get(name, node), str(error))
        return fault
