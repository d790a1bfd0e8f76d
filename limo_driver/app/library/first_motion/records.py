"""Records of the steps to a first motion, and which step may come next.

A step leaves `2_receive.json` and `2_receive.html`. A record counts for one description of the arm
and one address, and only while the record of the step before it is the one that it followed: who
repeats a step repeats those after it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.model import RobotModel
    from limo_driver.robot.registry import Examination

FORMAT: Final = "limo first motion"
VERSION: Final = 1
STEPS: Final = ("link", "receive", "shadow", "one-joint", "limopa")
TITLES: Final = {
    "link": "link and versions",
    "receive": "receive only",
    "shadow": "shadow",
    "one-joint": "one joint",
    "limopa": "LIMOPA",
}
PASSED: Final = "passed"
FAILED: Final = "failed"


def number_of(step: str) -> int:
    """Return the number of a step, from 1."""
    return STEPS.index(step) + 1


def digest(data: bytes) -> str:
    """Return the SHA-256 of something, as 64 digits."""
    return hashlib.sha256(data).hexdigest()


def description_digest(model: RobotModel) -> str:
    """Return what tells one description of an arm from another.

    Its file, the joints chosen, limits, bodies and gravity: also what a sim.yaml adds to it.
    """
    limits = {name: np.asarray(values).tolist() for name, values in vars(model.limits).items()}
    about = {
        "file": digest(model.urdf.read_bytes()),
        "joints": model.joint_names,
        "chosen": model.chosen,
        "limits": limits,
        "bodies": {
            name: [body.mass, *body.com, *np.asarray(body.tensor()).ravel().tolist()]
            for name, body in model.inertials.items()
        },
        "gravity": model.gravity,
    }
    return digest(json.dumps(about, sort_keys=True).encode())


@dataclass(frozen=True)
class Identity:
    """Whose records count.

    Args:
        robot: Name of the description.
        description: Its digest, of `description_digest`.
        address: Where the arm is reached; of an FRI arm whose controller nobody names, only
            after the first step.
    """

    robot: str
    description: str
    address: str

    def as_json(self) -> dict[str, str]:
        """Return plain values."""
        return dict(vars(self))


@dataclass(frozen=True)
class Folder:
    """The folder of an arm's records.

    Args:
        path: Of the folder.
    """

    path: Path

    def file(self, step: str, ending: str) -> Path:
        """Return a file of a step, such as `2_receive.json`."""
        return self.path / f"{number_of(step)}_{step.replace('-', '_')}{ending}"

    def read(self, step: str) -> dict[str, Any] | None:
        """Return the record of a step; None if there is none.

        Raises:
            ConfigError: It is damaged, or of another program.
        """
        path = self.file(step, ".json")
        try:
            found: object = json.loads(path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise ConfigError(f"is no record of a step: {error}", path=path) from None
        record = cast("dict[str, Any]", found) if isinstance(found, dict) else {}
        if record.get("format") != FORMAT or record.get("step") != step:
            raise ConfigError(f"is no record of the step {step}", path=path)
        if record.get("version") != VERSION:
            raise ConfigError(
                f"is of version {record.get('version')} of its format, expected {VERSION}; repeat "
                "the step",
                path=path,
            )
        return record

    def seal(self, step: str) -> str:
        """Return the digest of a step's record, by which the next one follows it."""
        return digest(self.file(step, ".json").read_bytes())

    def why_not(self, step: str, identity: Identity) -> str:
        """Say why the record of a step does not count; empty if it does."""
        number, record = number_of(step), self.read(step)
        name = f"step {number} ({TITLES[step]})"
        if record is None:
            return f"{name} was skipped: there is no {self.file(step, '.json').name}"
        if record["verdict"] != PASSED:
            problems = "; ".join(f["text"] for f in record["findings"] if f["problem"])
            return f"{name} failed: {problems}" if problems else f"{name} failed"
        if record["description"] != identity.description:
            return (
                f"{name} was done with another description of the arm ({record['robot']}, "
                f"{record['description'][:8]}) than this one ({identity.robot}, "
                f"{identity.description[:8]})"
            )
        if identity.address and record["address"] != identity.address:
            return (
                f"{name} was done at another address: {record['address']}, and this is "
                f"{identity.address}"
            )
        if number > 1 and record["follows"] != self.seal(STEPS[number - 2]):
            return (
                f"{name} was done before step {number - 1} ({TITLES[STEPS[number - 2]]}) was "
                "repeated"
            )
        return ""

    def require_before(self, step: str, identity: Identity) -> None:
        """Refuse a step before all those before it have passed.

        Raises:
            ConfigError: One is missing, failed, or of another arm; says which.
        """
        number = number_of(step)
        for before in STEPS[: number - 1]:
            if reason := self.why_not(before, identity):
                raise ConfigError(
                    f"step {number} ({TITLES[step]}) is refused, and nothing moves: {reason}; do "
                    f"`step` {before} first",
                    path=self.path,
                )

    def begin(self, step: str) -> None:
        """Forget the record of a step that is done again: until it ends, it has not passed."""
        self.file(step, ".json").unlink(missing_ok=True)

    def next_step(self, identity: Identity) -> str:
        """Return the first step that has not passed; the last one if all have."""
        return next((step for step in STEPS if self.why_not(step, identity)), STEPS[-1])

    def keep(
        self, step: str, identity: Identity, found: Examination, settings: dict[str, Any]
    ) -> dict[str, Any]:
        """Write the record of a step, and return it.

        Args:
            step: Its name.
            identity: Whose it is.
            found: What was found; it has passed if that is healthy.
            settings: With which it was done.

        Raises:
            ConfigError: It cannot be written.
        """
        number = number_of(step)
        record = {
            "format": FORMAT,
            "version": VERSION,
            "limo": version("limo"),
            "step": step,
            "verdict": PASSED if found.healthy else FAILED,
            "ended": datetime.now(UTC).isoformat(timespec="seconds"),
            **identity.as_json(),
            "follows": "" if number == 1 else self.seal(STEPS[number - 2]),
            "settings": settings,
            "findings": [vars(each) for each in found.findings],
            "figures": found.figures,
        }
        with whole(self.file(step, ".json")) as draft:
            draft.write_text(json.dumps(record, indent=1), encoding="utf-8")
        return record
