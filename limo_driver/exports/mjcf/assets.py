"""Files that an MJCF file names, meshes and textures: where they lie, and where in a copy of it.

What lies in the folder of the file keeps its place. Folders beside it, as `meshdir="../assets"`
names one, stand in the folder of the copy, and the copy says so. Absolute paths stay as they are.
Nothing farther away is copied: what a file of a stranger names there is none of its model.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import ConfigError
from limo_driver.runtime.installed_mujoco import mujoco

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.exports.xml_edits import XmlText

_FOLDERS: Final = ("meshdir", "texturedir", "assetdir")
_UP: Final = 2  # folders above that of the file, below which its assets may lie


@dataclass(frozen=True)
class Asset:
    """A file, and where it stands in the folder of a copy."""

    file: Path
    place: Path  # relative


def assets_of(into: Path) -> list[Asset]:
    """Return the files that an MJCF file names by relative paths, as far as they are there.

    Args:
        into: The file.

    Raises:
        ConfigError: One lies elsewhere than in its folder or in one of those beside it.
    """
    folder = into.resolve().parent
    found: dict[Path, Asset] = {}
    for stated, name in _named(mujoco.MjSpec.from_file(str(into))):
        if Path(stated).is_absolute() or Path(name).is_absolute():
            continue
        base = (folder / stated).resolve()
        file = (base / name).resolve()
        if not file.is_file():
            continue
        if file.is_relative_to(folder):
            place = file.relative_to(folder)
        elif file.is_relative_to(base) and base.is_relative_to(folder.parents[_UP - 1]):
            place = Path(_in_copy(stated, folder)) / file.relative_to(base)
        else:
            raise ConfigError(
                f"names {Path(stated) / name}, which is {file}; expected it in the folder of the "
                f"file, or in a meshdir below {folder.parents[_UP - 1]}: copy it there",
                path=into,
            )
        found.setdefault(file, Asset(file, place))
    return list(found.values())


def write_folders(texts: Sequence[XmlText], into: Path) -> None:
    """Write where the copy has the folders that lie beside that of the file.

    Args:
        texts: Of the file and its includes.
        into: The file.
    """
    folder = into.resolve().parent
    for text in texts:
        for element in text.root.walk():
            if element.tag != "compiler":
                continue
            for attribute in _FOLDERS:
                stated = element.attributes.get(attribute, "")
                is_beside = not (folder / stated).resolve().is_relative_to(folder)
                if is_beside and not Path(stated).is_absolute():
                    text.set(element, attribute, _in_copy(stated, folder))


def _named(spec: Any) -> Iterator[tuple[str, str]]:  # noqa: ANN401
    """Yield the folder and the name of every file."""
    for items, folder in (
        (spec.meshes, spec.meshdir),
        (spec.textures, spec.texturedir),
        (spec.hfields, spec.meshdir),
        (spec.skins, spec.meshdir),
    ):
        for item in items:
            for name in (item.file, *getattr(item, "cubefiles", ())):
                if name:
                    yield str(folder or ""), str(name)


def _in_copy(stated: str, folder: Path) -> str:
    """Return the folder of a copy that stands for one beside the file's."""
    name = (folder / stated).resolve().name
    return f"{name}_beside" if (folder / name).exists() else name
