"""Where recordings and trajectories lie: files by pattern, or objects of a store by URL."""

from __future__ import annotations

from contextlib import contextmanager
from errno import EINVAL
from pathlib import Path
from stat import S_ISREG
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from limo_driver.app.library.fleets.patterns import files_of
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable

    from estimators.fleet.row import FleetRow


def matched(
    given: Path | str | Iterable[Path | str], wanted: str = "recordings"
) -> tuple[Path | str, ...]:
    """Return the files and URLs that names and patterns stand for, each once, in order.

    Args:
        given: Names and patterns.
        wanted: What they should stand for.

    Raises:
        ConfigError: A pattern matches nothing, or its store cannot be listed.
    """
    found: dict[Path | str, None] = {}
    for item in [given] if isinstance(given, (Path, str)) else given:
        places = _objects(item) if isinstance(item, str) and _is_url(item) else _files(item)
        if not places:
            raise ConfigError(f"{item}: matches no file, expected {wanted}")
        found |= dict.fromkeys(places)
    if not found:
        raise ConfigError(f"no {wanted} given, expected files or patterns")
    return tuple(found)


def rows_of(recordings: Iterable[Path | str], simulation: str) -> list[FleetRow]:
    """Return a row for each recording; one that cannot be read or is there twice has an error.

    Args:
        recordings: Files and URLs.
        simulation: Digest of the simulation and how it is used.
    """
    from estimators.fleet.row import FleetRow, arm_of, date_of

    rows: list[FleetRow] = []
    first: dict[str, Path | str] = {}
    for place in recordings:
        key, size, error = "", 0, ""
        try:
            key, size = key_and_size(place, simulation)
        except OSError as failure:
            error = f"cannot be read: {failure.strerror or failure}"
        else:
            if first.setdefault(key, place) != place:
                error = f"the same recording as {first[key]}, and counted once"
        arm, date = arm_of(place), date_of(place)
        rows.append(FleetRow(place, key, arm, date, bytes=size, error=error))
    return rows


def key_and_size(place: Path | str, shared: str) -> tuple[str, int]:
    """Return the key of a file or object, which changes with it, and how large it is [bytes].

    Args:
        place: File or URL.
        shared: Digest of all else that its result depends on.

    Raises:
        OSError: It cannot be read.
    """
    from estimators.fleet.store import key_of, key_of_object

    if isinstance(place, Path):
        about = place.stat()
        if not S_ISREG(about.st_mode):  # to open a pipe waits until somebody writes to it
            raise OSError(EINVAL, "it is a pipe, a device or a folder, expected a file")
        return key_of(place, shared), about.st_size
    store, path = _store_of(place)
    return key_of_object(store.ukey(path), shared), store.size(path) or 0


@contextmanager
def at_hand(place: Path | str) -> Generator[Path]:
    """Give what lies at a place as a file on this machine; that of an object goes in the end."""
    if isinstance(place, Path):
        yield place
        return
    store, path = _store_of(place)
    with TemporaryDirectory() as folder:
        copy = Path(folder) / Path(path).name
        store.get_file(path, str(copy))
        yield copy


def _is_url(item: str) -> bool:
    return "://" in item and not Path(item).exists()


def _files(item: Path | str) -> list[Path]:
    if Path(item).is_file():  # also a name with brackets in it
        return [Path(item)]
    return files_of(str(item))


def _objects(pattern: str) -> list[str]:
    """Return the URLs that match; `zip://**/*.csv::s3://...` are files of an archive in a store."""
    outer = pattern.split("::")[1:]
    try:
        store, path = _store_of(pattern)
        found = sorted(n for n, about in store.glob(path, detail=True).items() if _is_file(about))
        return ["::".join([store.unstrip_protocol(name), *outer]) for name in found]
    except Exception as error:  # each kind of store has errors of its own
        line = " ".join(str(error).split())
        raise ConfigError(f"{pattern}: cannot be listed: {line}") from error


def _is_file(about: dict[str, Any]) -> bool:
    return about["type"] != "directory"


def _store_of(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, as `fsspec` knows it, and the path there."""
    from fsspec.core import url_to_fs

    return url_to_fs(url)
