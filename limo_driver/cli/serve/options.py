"""Turn the options of `limo serve` into checked settings, before anything is opened."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from estimators.service.settings import RetrainingSettings
    from estimators.service.store.served_models import ServedModels
    from limo_driver.logs.mcap_log import LogLimits

_BYTES_PER_GB = 1e9
_SECONDS_PER_DAY = 86400.0
_PART_UNDER_WAY = 0.1  # of all files of a log together, in the one that is being written


@dataclass(frozen=True)
class SigningKeys:
    """Whose signatures count, and what challengers are signed with."""

    trusted: tuple[Path, ...]
    own: Path | None

    def check(self, model: Path | None) -> None:
        """Check them before anything is opened.

        Raises:
            ConfigError: They are for versions, and a model folder is served.
            ModelStoreError: A key cannot be used, or what is signed would not be trusted.
        """
        from limo_driver.errors import ConfigError

        if model is not None and (self.trusted or self.own is not None):
            raise ConfigError("--trust and --sign are for the versions of a --store")
        if self.own is not None:
            from estimators.service.store.signature import check_signing

            check_signing(self.own, self.trusted)


def per_joint(
    option: str, text: str, unit: str, arms: dict[str, ServedModels]
) -> tuple[float, ...]:
    """Return one number, or one for each joint of every arm.

    Raises:
        ConfigError: It is no such list, or not above 0 and finite.
    """
    from limo_driver.errors import ConfigError

    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"{option} is {text!r}, expected numbers with commas between") from None
    if not all(0 < value < math.inf for value in values):
        raise ConfigError(f"{option} is {text} {unit}, expected above 0 and finite")
    for name, models in arms.items():
        n = models.physics.model.n
        if len(values) not in {1, n}:
            raise ConfigError(
                f"{option} has {len(values)} values, expected one, or one for each of the {n} "
                f"joints of {name}"
            )
    return values


def log_limits(size: float, age: float, arms: int) -> LogLimits:
    """Return the limits of each arm's log, whose share of the size is that of the others.

    Raises:
        ConfigError: A limit is not above 0.
    """
    from limo_driver.errors import ConfigError
    from limo_driver.logs.mcap_log import LogLimits

    for option, value, unit in (("--log-size", size, "GB"), ("--log-age", age, "days")):
        if not value > 0:
            raise ConfigError(f"{option} is {value:g} {unit}, expected above 0")
    total = size * _BYTES_PER_GB / arms
    # what is under way is never deleted, so that it has to be a small part
    one = min(LogLimits.file_bytes, _PART_UNDER_WAY * total)
    return LogLimits(file_bytes=one, total_bytes=total, total_seconds=age * _SECONDS_PER_DAY)


def stores_of(
    given: list[str], store: Path | None, model: Path | None, sim: Path | None
) -> dict[str, Path | None]:
    """Return the store of each arm by name, None where a model folder serves instead.

    Raises:
        ConfigError: An arm is named twice, or has no store, or two.
    """
    from limo_driver.errors import ConfigError
    from limo_driver.network.streaming import Keys

    if model is not None and sim is not None:
        raise ConfigError("--model brings its own simulation; --sim is for --store")
    stores: dict[str, Path | None] = {}
    for entry in given:
        name, _, own = entry.partition("=")
        Keys(name)  # refuses what cannot be part of a key
        if name in stores:
            raise ConfigError(f"--arm {name} is given twice")
        if own and store is not None:
            raise ConfigError(f"--arm {entry} names a store, and so does --store {store}")
        stores[name] = Path(own) if own else store
        if (stores[name] is None) == (model is None):
            raise ConfigError("give --arm NAME=STORE, --store or --model, one of them")
    return stores


def load_models(
    store: Path | None, model: Path | None, sim: Path | None, keys: SigningKeys
) -> ServedModels:
    """Load the physics of an arm, and with it what serves.

    Raises:
        LimoError: A store has no version that can be read, or a folder does not fit together.
    """
    from estimators.service.store.served_models import OneFolder, StoreModels
    from estimators.service.store.store import ModelStore
    from limo_driver.physics import Simulation

    if model is not None:
        return OneFolder.open(model)
    simulation = None if sim is None else Simulation.load(sim)
    robot = None if simulation is None else simulation.model.name
    versions = ModelStore(store or Path(), robot, keys.trusted, keys.own)
    models = StoreModels(versions, simulation)
    _ = models.physics  # refuses an empty store
    return models


def retraining_of(
    stores: dict[str, Path | None],
    log: Path | None,
    wanted: bool | None,
    hours: float | None,
    seconds: float,
    kind: str,
) -> RetrainingSettings | None:
    """Return how to retrain, or None where it is not wanted or not possible."""
    from estimators.service.settings import RetrainingSettings
    from limo_driver.errors import ConfigError

    roots = {name: store for name, store in stores.items() if store is not None}
    possible = len(roots) == len(stores) and log is not None
    if wanted and not possible:
        raise ConfigError("--retrain needs --store for the models and --log to learn from")
    if hours is not None and (wanted is False or not possible):
        raise ConfigError("--retrain-every is for a service that retrains: give --store and --log")
    if possible and wanted is not False:
        _refuse_shared_stores(roots)
    if kind != "same":
        from estimators.service.training.learning import check_kind

        check_kind(kind)
    every = None if hours is None else 3600.0 * hours
    settings = RetrainingSettings(seconds, every, kind=kind)
    return settings if possible and wanted is not False else None


def _refuse_shared_stores(stores: dict[str, Path]) -> None:
    """Refuse to retrain two arms in one store, where one would let the other's models serve."""
    from limo_driver.errors import ConfigError

    arms: dict[Path, str] = {}
    for name, store in stores.items():
        other = arms.setdefault(store.resolve(), name)
        if other != name:
            raise ConfigError(
                f"arms {other} and {name} share the store {store}, which has one champion: give "
                "each a store of its own, or --no-retrain"
            )
