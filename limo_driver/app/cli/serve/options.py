"""Turn the options of `limo serve` into checked settings, before anything is opened."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from estimators.service.settings import RetrainingSettings, ServiceSettings
    from limo_driver.logs.mcap_log import LogLimits

_BYTES_PER_GB = 1e9
_SECONDS_PER_DAY = 86400.0
_PART_UNDER_WAY = 0.1  # of all files of a log together, in the one that is being written


def settings_of(
    rate: float | None, delay: float, bound: float | None, contact: str, contact_for: str
) -> ServiceSettings:
    """Return how estimates are made and judged.

    Raises:
        ConfigError: A value is not above 0, or no such list.
    """
    from estimators.service.settings import ServiceSettings

    return ServiceSettings(
        rate=rate,
        delay=delay,
        bound=bound,
        contact_torque=per_joint("--contact", contact, "N m"),
        contact_duration=per_joint("--contact-for", contact_for, "s"),
    )


def per_joint(option: str, text: str, unit: str) -> tuple[float, ...]:
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


def stores_of(given: list[str], store: Path | None) -> dict[str, Path | None]:
    """Return the store of each arm by name, None where none is given.

    Raises:
        ConfigError: An arm is named twice, or has two stores.
    """
    from limo_driver.errors import ConfigError

    stores: dict[str, Path | None] = {}
    for entry in given:
        name, _, own = entry.partition("=")
        if name in stores:
            raise ConfigError(f"--arm {name} is given twice")
        if own and store is not None:
            raise ConfigError(f"--arm {entry} names a store, and so does --store {store}")
        stores[name] = Path(own) if own else store
    return stores


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

    possible = None not in stores.values() and log is not None
    if wanted and not possible:
        raise ConfigError("--retrain needs --store for the models and --log to learn from")
    if hours is not None and (wanted is False or not possible):
        raise ConfigError("--retrain-every is for a service that retrains: give --store and --log")
    if kind != "same":
        from estimators.service.training.learning import check_kind

        check_kind(kind)
    every = None if hours is None else 3600.0 * hours
    settings = RetrainingSettings(seconds, every, kind=kind)
    return settings if possible and wanted is not False else None
