"""Versions of the models of robots, one of which serves.

models/
└── <robot>/
    ├── 1/, 2/, …       versions; see `version`
    └── aliases.json    which is the champion, and every change of it; see `aliases`

A version appears by one rename of a folder that is on the disk in full, aliases change by one
rename of a file. So readers need no lock, and a writer that is killed leaves nothing half done.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from estimators.service.store.adding import as_json, gather, recorded, robot_of
from estimators.service.store.aliases import (
    ALIASES,
    NAMES,
    Aliases,
    draft,
    locked,
    read_aliases,
    sign,
    write,
)
from estimators.service.store.aliases import replace_file as replace
from estimators.service.store.version import GOLDEN, RECORD, Golden, Version
from limo_driver.errors import ModelStoreError
from limo_driver.runtime.outputs import sync

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from typing import Any

    from limo_driver.recordings.recording import Recording

_NUMBER: Final = re.compile(r"[1-9][0-9]{0,8}")


class ModelStore:
    """The versions of one robot's models, in a folder that may hold those of others.

    Args:
        root: The folder; it need not be there yet.
        robot: Whose versions; not needed where the folder holds those of one robot only.
        trusted_keys: Public keys (PEM files); versions that none of them signed are refused. None
            given: signatures are not looked at.
        signing_key: Private key (PEM file), with which every version that is added is signed.
    """

    def __init__(
        self,
        root: Path | str,
        robot: str | None = None,
        trusted_keys: Sequence[Path] = (),
        signing_key: Path | None = None,
    ) -> None:
        self.root, self.trusted_keys = Path(root), tuple(trusted_keys)
        self.signing_key = signing_key
        self._robot = robot

    @property
    def robots(self) -> tuple[str, ...]:
        """Robots that the folder holds versions of."""
        if not self.root.is_dir():
            return ()
        return tuple(sorted(path.name for path in self.root.iterdir() if _numbers(path)))

    @property
    def robot(self) -> str:
        """Whose versions these are.

        Raises:
            ModelStoreError: It was not said and is not clear.
        """
        if self._robot is not None:
            return self._robot
        robots = self.robots
        if not robots:
            raise ModelStoreError(f"{self.root}: holds no versions; add one first")
        first, *others = robots
        if others:
            raise ModelStoreError(
                f"{self.root}: holds versions of {', '.join(robots)}; say of which robot"
            )
        return first

    @property
    def home(self) -> Path:
        """Folder of the robot's versions."""
        return self.root / self.robot

    @property
    def aliases(self) -> Aliases:
        """Champion, challenger, and how that came about.

        Raises:
            ModelStoreError: The file cannot be understood.
        """
        return read_aliases(self.home)

    def numbers(self) -> tuple[int, ...]:
        """Return the numbers of the versions, in order."""
        return _numbers(self.home)

    def versions(self, tell: Callable[[str], None] | None = None) -> tuple[Version, ...]:
        """Read all versions, in order.

        Args:
            tell: Told why, of each that cannot be read, and is left out.

        Raises:
            ModelStoreError: One cannot be understood, or is not signed as it has to be, and nobody
                is to be told.
        """
        found = list[Version]()
        for number in self.numbers():
            try:
                found.append(self.open(number))
            except ModelStoreError as error:
                if tell is None:
                    raise
                tell(str(error))
        return tuple(found)

    def open(self, which: int | str) -> Version:
        """Read the record of a version; `Version.load` gives the model.

        Args:
            which: Its number, `champion` or `challenger`.

        Raises:
            ModelStoreError: There is no such version, it cannot be understood, or no trusted key
                signed it.
        """
        return Version.read(self.home / str(self.number(which)), self.trusted_keys)

    def number(self, which: int | str) -> int:
        """Return the number of a version by number or alias.

        Raises:
            ModelStoreError: There is no such version.
        """
        if which in NAMES:
            number = getattr(self.aliases, str(which))
            if number is None:
                raise ModelStoreError(f"{self.home / ALIASES}: there is no {which}")
            which = number
        if (text := str(which)).isdecimal() and int(text) in self.numbers():
            return int(text)
        known = ", ".join([*map(str, self.numbers()), *NAMES])
        raise ModelStoreError(f"{self.home}: has no version {which!r}; known: {known}")

    def add(
        self,
        folder: Path | str,
        *,
        golden: Recording,
        parent: int | None = None,
        record: Mapping[str, Any] | None = None,
        delay: float = 0.1,
    ) -> Version:
        """Add a model folder as the next version.

        Args:
            folder: As `limo train` writes it; it is loaded, and copied.
            golden: Motion whose liveliest seconds are kept with what the model answers to them.
            parent: Version that this one came from.
            record: What else is known of it, as JSON values, for example `metrics`.
            delay: Of the stream that answers to the golden motion [s].

        Raises:
            ModelStoreError: The folder does not fit together, the parent is not there, the record
                is no JSON, or the signing key cannot be used.
            RecordingError: The golden motion is of another robot.
            ConfigError: The model cannot be streamed at that rate and delay.
        """
        home = self.root / self._robot_of(Path(folder))
        try:
            home.mkdir(parents=True, exist_ok=True)
            with draft(home) as path:
                model = gather(Path(folder), path, home.name)
                golden.check_robot(model.simulation.model)
                kept, found = Golden.of(model, golden, delay)
                write(path / GOLDEN, kept.as_bytes())
                content = recorded(path, model, kept, found, record or {})
                with locked(home):
                    numbers = _numbers(home)
                    if parent is not None and parent not in numbers:
                        raise ModelStoreError(f"{home}: has no version {parent} to be the parent")
                    number = max(numbers, default=0) + 1
                    write(path / RECORD, as_json({**content, "version": number, "parent": parent}))
                    if self.signing_key is not None:
                        sign(path / RECORD, self.signing_key)
                    sync(path)
                    final = path.rename(home / str(number))
                    sync(home)
                return Version.read(final)
        except OSError as error:
            raise ModelStoreError(f"{home}: cannot be written: {error.strerror}") from None

    def promote(self, which: int | str, reason: str, instead_of: int | None = None) -> Aliases:
        """Make a version the champion; its files are checked first.

        Args:
            which: Its number or alias.
            reason: Why, for the record.
            instead_of: Champion that it was judged against; no other is replaced.

        Raises:
            ModelStoreError: There is no such version, a file of it differs, or it is the champion,
                or another one is than was judged against.
        """
        version = self.open(which)
        version.check_files()

        def forth(aliases: Aliases) -> Aliases:
            aliases.check_champion(instead_of)
            return aliases.promote(version.number, reason)

        return self._rename(forth)

    def rollback(self, reason: str, instead_of: int | None = None) -> Aliases:
        """Make the champion before the champion again.

        Args:
            reason: Why, for the record.
            instead_of: Champion that is sent back; no other is.

        Raises:
            ModelStoreError: There is none, or a file of it differs, or another one is the champion.
        """

        def back(aliases: Aliases) -> Aliases:
            aliases.check_champion(instead_of)
            after = aliases.rollback(reason)
            self.open(after.champion or 0).check_files()
            return after

        return self._rename(back)

    def challenge(self, which: int | str | None, reason: str) -> Aliases:
        """Make a version the challenger; None: there is none any more.

        Raises:
            ModelStoreError: There is no such version, or it is the champion.
        """
        number = None if which is None else self.open(which).number
        return self._rename(lambda aliases: aliases.challenge(number, reason))

    def verify(self, which: int | str) -> float:
        """Check files and signature, load, and replay the golden motion.

        Returns:
            By how much the torque differs from that of the day it was added, at most [N m].

        Raises:
            ModelStoreError: Anything of it fails, by name.
        """
        return self.open(which).verify()

    def sign(self, which: int | str, key: Path) -> None:
        """Sign a version with a private key (PEM), after its files were checked.

        Raises:
            ModelStoreError: There is no such version, a file differs, or the key cannot be used.
        """
        version = Version.read(self.home / str(self.number(which)))
        version.check_files()
        with locked(self.home):
            sign(version.path / RECORD, key)

    def _rename(self, change: Callable[[Aliases], Aliases]) -> Aliases:
        home = self.home
        try:
            with locked(home):
                after = change(read_aliases(home))
                replace(home / ALIASES, after.as_json())
        except OSError as error:
            raise ModelStoreError(f"{home}: cannot be written: {error.strerror}") from None
        return after

    def _robot_of(self, folder: Path) -> str:
        """Return the robot of a model folder, checked to be the store's and a name for a folder."""
        robot = robot_of(folder)
        if self._robot is not None and robot != self._robot:
            raise ModelStoreError(f"{folder}: is of robot {robot}, expected {self._robot}")
        return robot


def _numbers(home: Path) -> tuple[int, ...]:
    """Return the numbers of the versions in a folder; they appear complete, by a rename."""
    if not home.is_dir():
        return ()
    return tuple(sorted(int(path.name) for path in home.iterdir() if _NUMBER.fullmatch(path.name)))
