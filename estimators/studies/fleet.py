"""Results of a fleet, kept one by one, and all of them together.

The store of a fleet: a folder for each recording, whose row is written last and in one piece.

A row is there in full or not at all, and on the disk before it is told; so what is finished
survives the end of any process.
"""

from __future__ import annotations

import json
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

import yaml

from estimators.diagnosis.reading import verdict_in
from estimators.diagnosis.verdict import IMPROVED
from estimators.studies.fleet_row import FLEET
from estimators.studies.fleet_standing import (
    drifts_of,
    few_dates,
    series_of,
    spreads_of,
    standings_of,
)
from limo_driver.runtime.outputs import KeptResults

if TYPE_CHECKING:
    from collections.abc import Container, Mapping, Sequence

    from estimators.studies.fleet_row import FleetOutcome, FleetRow
    from estimators.studies.fleet_standing import ArmStanding, FleetDrift, Series, UnitSpread
    from limo_driver.physics import Simulation

_NAMED: Final = 4  # arms in a headline
ROW: Final = "row.json"
DIAGNOSES: Final = "diagnoses"
_SHOWN: Final = 24  # digits of a key: 96 bits


@dataclass(frozen=True)
class FleetDiagnosis:
    """The rows of a fleet, in the order of their recordings, and what they say together."""

    robot: str
    rows: tuple[FleetRow, ...]
    set_aside: Mapping[str, int] = field(default_factory=dict[str, int])  # rows by other versions
    joints: tuple[str, ...] = ()  # names, as the description has them; numbers alone if not given

    @cached_property
    def series(self) -> tuple[Series, ...]:
        """Errors and values over arms and dates."""
        return series_of(self.rows, self.joints)

    @cached_property
    def drifts(self) -> tuple[FleetDrift, ...]:
        """What changes over dates, surest first."""
        return drifts_of(self.series)

    @cached_property
    def standings(self) -> tuple[ArmStanding, ...]:
        """How far each arm is from the others, farthest first."""
        return standings_of(self.series, self.drifts)

    @cached_property
    def spreads(self) -> tuple[UnitSpread, ...]:
        """How units differ in each quantity."""
        return spreads_of(self.series)

    @property
    def odd(self) -> tuple[str, ...]:
        """Arms that are the odd ones out, the oddest first."""
        return tuple(dict.fromkeys(item.arm for item in self.standings if item.odd))

    @property
    def drifting(self) -> tuple[str, ...]:
        """Arms of which something drifts, the surest first."""
        return tuple(dict.fromkeys(item.arm for item in self.drifts))

    @cached_property
    def sentences(self) -> dict[str, str]:
        """What is to be known of each arm that drifts or is odd: of its quantities, the clearest.

        An error says that something is wrong, a value what, so that it goes before.
        """
        drifts = sorted(self.drifts, key=lambda item: item.series.ratio)
        odd = sorted((x for x in self.standings if x.odd), key=lambda item: item.series.ratio)
        found = dict[str, str]()
        for item in (*drifts, *odd):
            found.setdefault(item.arm, str(item))
        return found

    @property
    def failed(self) -> tuple[FleetRow, ...]:
        """Rows without a verdict."""
        return tuple(row for row in self.rows if not row.diagnosed)

    @property
    def headline(self) -> str:
        """Say in one sentence which arms are odd, and which drift."""
        parts = [
            f"{what}: {', '.join(arms[:_NAMED])}"
            + (f" and {len(arms) - _NAMED} more" if len(arms) > _NAMED else "")
            for what, arms in (("odd", self.odd), ("drifting", self.drifting))
            if arms
        ]
        if parts:
            sentence = "; ".join(parts)
            return f"{sentence[0].upper()}{sentence[1:]}"
        if not self.standings:
            return f"Fewer than {FLEET.arms} arms: none can be told from the others"
        return "No arm is odd, and no drift shows"

    def __str__(self) -> str:
        arms = len({row.arm for row in self.rows if row.diagnosed})
        done = len(self.rows) - len(self.failed)
        lines = [f"{done} of {len(self.rows)} recordings diagnosed, of {arms} arms."]
        for other, count in self.set_aside.items():
            lines.append(f"set aside: {count} diagnoses by limo {other}, not of this version")
        if self.sentences:
            lines += [f"{arm}: {sentence}" for arm, sentence in self.sentences.items()]
        else:
            odd = "no arm is odd" if self.standings else f"no arm of fewer than {FLEET.arms} is odd"
            lines.append(f"{odd}, and no drift shows")
        if self.series and (few := few_dates(self.series)):
            lines.append(few)
        return "\n".join(lines)


def changed(item: FleetDrift) -> str:
    """Say how much a quantity changed over its dates, with the interval of 95 %."""
    low, high = item.interval
    if item.series.ratio:
        return f"{100 * item.change:+.0f} % ({100 * low:+.0f} to {100 * high:+.0f} %)"
    return f"{item.change:+.3g} ({low:+.3g} to {high:+.3g}) {item.series.unit}"


@dataclass(frozen=True)
class FleetStore:
    """Rows in a folder, by key."""

    folder: Path

    def place(self, key: str) -> Path:
        """Return the folder of a diagnosis."""
        return self._kept.place(key)

    @property
    def _kept(self) -> KeptResults:
        return KeptResults(self.folder / DIAGNOSES, ROW)

    def keep(self, key: str, outcome: FleetOutcome) -> None:
        """Keep how a diagnosis ended: first its files, if it has any, and last its row.

        Args:
            key: Of the recording under this simulation.
            outcome: Of its diagnosis.

        Raises:
            ConfigError: It cannot be written.
        """

        def improved(place: Path) -> None:
            if outcome.simulation is not None:
                outcome.simulation.save(place / IMPROVED)

        about = {
            "seconds": outcome.seconds,
            "error": outcome.error,
            "limo": version("limo"),
        }
        self._kept.keep(key, about, outcome.files, improved)

    def of_other_versions(self, keys: Container[str]) -> dict[str, int]:
        """Count rows by the versions of limo that are not this one, but for those of some keys."""
        places = [p for p in self.folder.glob(f"{DIAGNOSES}/*/{ROW}") if p.parent.name not in keys]
        found: Counter[str] = Counter()
        for place in places:
            with suppress(OSError, ValueError, TypeError, AttributeError):  # no row, then
                kept = json.loads(place.read_text(encoding="utf-8"))
                found[str(kept.get("limo", "of an unknown version"))] += 1
        del found[version("limo")]
        return dict(sorted(found.items()))

    def finished(self, row: FleetRow) -> FleetRow | None:
        """Return a row with how it ended; None while it has not, or where its files are damaged."""
        place, kept = self.place(row.key), self._kept.finished(row.key)
        if kept is None:
            return None
        try:
            done = replace(row, seconds=float(kept["seconds"]), error=str(kept["error"]))
            if done.error:
                return done
            return replace(done, verdict=verdict_in(place), folder=place)
        except (OSError, ValueError, KeyError, TypeError):  # ConfigError is a ValueError
            return None


def key_of(files: Sequence[Path], simulation: str) -> str:
    """Return the key of a recording: it changes with its bytes, the simulation and limo's version.

    Args:
        files: Of the recording, to read.
        simulation: Digest of the simulation and how it is used.

    Raises:
        OSError: One cannot be read.
    """
    digest = sha256(simulation.encode())
    for path in files:
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()[:_SHOWN]


def key_of_object(known: str, simulation: str) -> str:
    """Return the key of an object of a store: it changes with what the store says of it.

    Args:
        known: Fingerprint that the store has of the object, which is not read for it.
        simulation: Digest of the simulation and how it is used.
    """
    return sha256(f"{simulation} {known}".encode()).hexdigest()[:_SHOWN]


def digest_of(simulation: Simulation, *use: object) -> str:
    """Return the digest of a simulation, wherever its files lie, its use, and limo's version."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sim.yaml"
        simulation.save(path)
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    del content["robot"]  # a path, which may have moved; what the file says is in the text below
    model = simulation.model
    parts = [content, model.name, model.description.text, *use, version("limo")]
    return sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
