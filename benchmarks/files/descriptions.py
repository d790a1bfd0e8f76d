"""Public descriptions of robots: how many load for planning, and how many for a diagnosis.

    python benchmarks/files/descriptions.py FOLDER [--skip ros-industrial] [--refused]

Each folder in FOLDER is a collection, as `git clone` leaves it. A robot is a URDF or MJCF file with
a joint that turns or slides; copies are counted once, and files whose parts (meshes, includes) the
collection lacks are only counted as such. Loaded for planning is what `RobotModel` takes; those
that leave out ranges have to state them before they are planned. Loaded for a diagnosis is what a
`Simulation` computes finite torques of. Ends with 1 if either is below 95 %, or fewer than 300
robots of 5 collections were found.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import warnings
from collections import Counter
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limo_driver.errors import LimoError
from limo_driver.model import RobotModel
from limo_driver.physics import Simulation

if TYPE_CHECKING:
    from collections.abc import Iterator

ROBOTS, COLLECTIONS, LOADED = 300, 5, 0.95
_MOVABLE: Final = re.compile(
    rb"<joint\b[^>]*\stype\s*=\s*['\"](revolute|continuous|prismatic)['\"]"
)
_OF_MJCF: Final = re.compile(rb"<worldbody>.*?<joint\b.*?</worldbody>|<include\b", re.DOTALL)
_COMMENT: Final = re.compile(rb"<!--.*?-->", re.DOTALL)
_LACKS: Final = ("which is not there", "Error opening file")
_NO_ROBOT: Final = "has no joint that turns or slides"


class Tried(NamedTuple):
    """What came of one file."""

    collection: str
    planned: bool
    has_ranges: bool
    has_masses: bool
    diagnosed: bool
    refusal: str


def main() -> None:
    """Try all files, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="of collections")
    parser.add_argument("--skip", nargs="*", default=["ros-industrial"], help="names of folders")
    parser.add_argument("--refused", action="store_true", help="print each refusal")
    given = parser.parse_args()
    os.environ.setdefault("LIMO_DESCRIPTIONS", str(given.folder.resolve()))
    warnings.simplefilter("error")
    tried, lacking = list[Tried](), Counter[str]()
    for collection, path in _robots(given.folder, set(given.skip)):
        found = _tried(collection, path)
        if found.refusal.endswith(_NO_ROBOT):
            continue
        if path.suffix == ".xml" and any(text in found.refusal for text in _LACKS):
            lacking[collection] += 1
            continue
        tried.append(found)
    if given.refused:
        print("\n".join(each.refusal for each in tried if each.refusal), end="\n\n")
    folders = sorted(path for path in given.folder.iterdir() if path.is_dir())
    sys.exit(not _said(folders, tried, lacking))


def _robots(folder: Path, skipped: set[str]) -> Iterator[tuple[str, Path]]:
    seen = set[bytes]()
    for collection in sorted(path for path in folder.iterdir() if path.is_dir()):
        for path in sorted(collection.rglob("*")):
            known = path.suffix.lower() in {".urdf", ".xml"} and path.is_file()
            if not known or skipped & {*path.parts}:
                continue
            text = _COMMENT.sub(b"", path.read_bytes())
            is_mjcf = path.suffix == ".xml"
            if is_mjcf and not (b"<mujoco>" in text or b"<mujoco " in text):
                continue
            digest = sha256(text).digest()
            if (_OF_MJCF if is_mjcf else _MOVABLE).search(text) and digest not in seen:
                seen.add(digest)
                yield collection.name, path


def _tried(collection: str, path: Path) -> Tried:
    planned = has_ranges = diagnosed = False
    has_masses = b"<mass" in path.read_bytes() or path.suffix == ".xml"
    refusal = ""
    try:
        model = RobotModel.load(path)
        planned, has_masses, has_ranges = True, not model.massless, not model.description.unranged
        if has_masses:
            torque = Simulation.load(path).body.gravity_torque(np.zeros(model.n))
            diagnosed = bool(np.isfinite(torque).all())
    except LimoError as error:
        refusal = str(error)
        assert refusal.isprintable(), refusal  # one line
    return Tried(collection, planned, has_ranges, has_masses, diagnosed, refusal)


def _said(folders: list[Path], tried: list[Tried], lacking: Counter[str]) -> bool:
    """Print the table; say whether all of it meets what is expected."""
    names = list(dict.fromkeys(each.collection for each in tried))
    if bare := [path.name for path in folders if path.name not in {*names, *lacking}]:
        print(f"without a URDF or MJCF file (xacro files are to be expanded): {', '.join(bare)}")
    print("| collection | robots | load for planning | state all ranges | ", end="")
    print("state masses | load for diagnosis | parts not there |\n|---|---|---|---|---|---|---|")
    for name in names:
        _row(name, [each for each in tried if each.collection == name], lacking[name])
    _row("all", tried, lacking.total())
    massive = [each for each in tried if each.has_masses]
    enough = len(tried) >= ROBOTS and len(names) >= COLLECTIONS
    plans = sum(each.planned for each in tried) >= LOADED * len(tried)
    return enough and plans and sum(x.diagnosed for x in massive) >= LOADED * len(massive)


def _row(name: str, tried: list[Tried], lacking: int) -> None:
    planned, massive = sum(each.planned for each in tried), [x for x in tried if x.has_masses]
    diagnosed = sum(each.diagnosed for each in massive)
    print(
        f"| {name} | {len(tried)} | {planned} ({planned / max(len(tried), 1):.1%}) | "
        f"{sum(each.has_ranges for each in tried)} | {len(massive)} | {diagnosed} "
        f"({diagnosed / max(len(massive), 1):.1%}) | {lacking} |"
    )


if __name__ == "__main__":
    main()
