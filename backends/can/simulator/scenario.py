"""Scenario files: what goes wrong, and when.

```yaml
seed: 1
faults:
  - {fault: lose_frames, probability: 0.01, way: from_drives}
  - {fault: drive_fault, joint: 3, at: 2.5, code: 0x4310}
```
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from backends.can.simulator.faults import KINDS, Fault
from limo_driver.runtime.declarations import read_yaml
from limo_driver.runtime.parameters import Declared, parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from backends.can.config import Joint


@dataclass(frozen=True)
class BusScenario(Declared):
    """Faults, and the seed of their chances."""

    faults: tuple[Fault, ...] = ()
    seed: int = parameter("", "of chances", lower=0, default=0)

    @classmethod
    def load(cls, path: Path | str, joints: Sequence[Joint]) -> BusScenario:
        """Read a scenario for an arm.

        Raises:
            ConfigError: Names the line, what was given and what exists.
        """
        given = read_yaml(Path(path), needs="`faults:`")
        if "faults" not in given:
            given.fail("lacks `faults:`, a list of `- {fault: ..., at: ...}`")
        faults: list[Fault] = []
        for entry in given["faults"].sections():
            faults.append(entry.make_one_of("fault", KINDS, len(joints)))
            with entry.blamed():
                faults[-1].check(joints)
        return given.make(cls, {"faults": tuple(faults)})
