"""Export: a simulation in a copy of the user's own file, what changed in it, and a proof of it."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from difflib import unified_diff
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.exports.changes.joints import sharp
from limo_driver.exports.changes.target import Target, target_of
from limo_driver.exports.mjcf import FIRMNESS, edited_mjcf, rubs_anew
from limo_driver.exports.proof import errors
from limo_driver.exports.remainder import Remainder, proof_motion, remainders, unwritten
from limo_driver.exports.servos import have_changed, write_rests
from limo_driver.exports.urdf import actuators, edited_urdf
from limo_driver.exports.usd import files_of, write_layer
from limo_driver.exports.xml_edits import ISAAC_LAB, MJCF, URDF, USD, assets_of, edited_format
from limo_driver.model.descriptions.description import DOWN
from limo_driver.physics import GravityDirection, Simulation
from limo_driver.runtime.display import Displayed
from limo_driver.runtime.installed_mujoco import RELEASE, VERSION
from limo_driver.runtime.outputs import require_apart, require_folder, whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from limo_driver.exports.xml_edits import XmlText
    from limo_driver.types import Motion

PROVEN: Final = 0.01  # of a joint's torque, RMS, that a plain simulator's should be near to

_NOTHING: Final = 1e-4  # of the torque, up to which nothing is left


@dataclass(frozen=True, repr=False)
class Export(Displayed):
    """What was written, what of it changed, what is missing, and how near a plain simulator is."""

    file: Path
    files: tuple[Path, ...]  # all that were written, with includes and meshes
    kind: str
    diff: str  # of the texts; empty where nothing changed
    remainder: tuple[Remainder, ...]
    joint_names: tuple[str, ...]
    error: tuple[float, ...]  # RMS of plain simulator less prediction, (n,) [N m]
    torque: tuple[float, ...]  # RMS of the prediction, (n,) [N m]
    kept: tuple[str, ...] = ()  # lines: what the file states of joints and nothing was said of
    dropped: tuple[str, ...] = ()  # lines: what an earlier export wrote and is not found any more
    unwritten: tuple[str, ...] = ()  # lines: numbers of drives that the format does not have
    needs: str = ""  # what a reader has to be, if not every one can read it

    @property
    def share(self) -> float:
        """RMS of the difference over that of the torque, all joints together."""
        total = sum(value**2 for value in self.torque) ** 0.5
        return sum(value**2 for value in self.error) ** 0.5 / total if total else 0.0

    @property
    def left(self) -> tuple[Remainder, ...]:
        """What is not expressed, where that is any torque."""
        least = _NOTHING * max(self.torque, default=0.0)
        return tuple(item for item in self.remainder if max(item.rms) > least)

    def headline(self) -> str:
        """Say what was written, and how well it was proven."""
        kept = " with what the file keeps" if self.kept else ""
        kept += ", less what is left," if self.left else ","
        plain = "MuJoCo" if self.kind == MJCF else "pinocchio"
        return (
            f"{self.file}: {(len(self.diff.splitlines()) and 'changed') or 'nothing to change'}; "
            f"{plain} alone needs what limo predicts{kept} to {self.share:.2%} of the torque "
            "(RMS, in motion)"
        )

    def __str__(self) -> str:
        """Say what is not as in the file or in the simulation, and then what was proven."""
        parts = {
            "kept": self.kept,
            "dropped": self.dropped,
            "not written": self.unwritten,
            "needs": [self.needs] if self.needs else [],
            "left": self.left,
        }
        lines = [f"{what}: {line}" for what, own in parts.items() for line in own]
        return "\n".join([*lines, super().__str__()])

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the errors of each joint."""
        return {
            "joint": self.joint_names,
            "difference [N m]": self.error,
            "torque, RMS [N m]": self.torque,
        }


def write(
    simulation: Simulation,
    into: Path,
    kind: str,
    out: Path,
    motion: Motion | None = None,
    name: str = "",
    release: int = RELEASE[0],
) -> Export:
    """Write a simulation into a copy of a file, and prove it.

    Args:
        simulation: What was found.
        into: The file, which is not changed.
        kind: One of `KINDS`.
        out: Folder for the copy, and for what it includes and names.
        motion: On which what is missing is counted; a minute through the range if not given.
        name: Of the copy; that of the file if empty.
        release: Of MuJoCo, that shall read it: 3 or 4.

    Raises:
        ConfigError: It is of another arm, or cannot be written.
    """
    if release > RELEASE[0]:
        raise ConfigError(
            f"what MuJoCo {release} reads cannot be proven by the {VERSION} that is installed; "
            f"expected `mujoco` of at most {RELEASE[0]}, or MuJoCo {release} itself"
        )
    target = target_of(simulation, into, kind, release)
    simulation = target.simulation
    on = proof_motion(simulation.model)
    left = remainders(simulation, target.split, motion or on)
    expressed = replace(simulation, effects=tuple(map(sharp, target.split.expressed)))
    stated = {URDF: DOWN, USD: target.model.gravity}.get(edited_format(kind))
    if stated is not None and not np.allclose(
        [simulation.model.gravity, simulation.body.gravity], stated
    ):
        own = GravityDirection(gravity=tuple(np.array(stated).tolist()))
        expressed = replace(expressed, effects=(*expressed.effects, own))
        if not np.allclose(simulation.body.gravity, stated):
            left = (*left, _gravity(simulation, motion or on, stated))
    require_folder(out, "the export")
    if kind == USD:
        place = out / (name or f"{into.stem}_found.usda")
        copied = _copied(files_of(into), into, out)
        text, driven = write_layer(target, place)
        error, torque = errors(place, kind, expressed, on)
        names = simulation.model.joint_names
        files = (place, *driven.files, *copied)
        gone = (*target.dropped, *driven.dropped)
        return Export(
            place, files, kind, _added(text), left, names, error, torque, target.kept, gone,
            driven.unwritten,
        )  # fmt: skip
    texts = edited_mjcf(target) if kind == MJCF else edited_urdf(target, kind)
    places, copied = _places(texts, into, out, name), _copy(texts, into, out, kind)
    _write_texts(texts, places, target)
    if kind == ISAAC_LAB:
        beside = places[0].with_suffix(".py")
        with whole(beside) as draft:
            names = simulation.model.joint_names
            drives = simulation.drives
            text = actuators(places[0].name, names, target.split.joints, drives)
            draft.write_text(text, "utf-8")
        copied = [beside, *copied]
    error, torque = errors(places[0], kind, expressed, on)
    firm = dict[int, str]()
    for firmness in FIRMNESS if kind == MJCF else ():
        unproven = {j for j in range(len(error)) if error[j] > PROVEN * torque[j]}
        if not (soft := unproven & rubs_anew(target)):
            break
        firm |= dict.fromkeys(soft, firmness)
        texts = edited_mjcf(target, firm)
        _write_texts(texts, places, target)
        error, torque = errors(places[0], kind, expressed, on)
    diff = "".join(_diff(text, place) for text, place in zip(texts, places, strict=True))
    files = (*places, *copied)
    names = simulation.model.joint_names
    kept, gone = target.kept, target.dropped
    missing = unwritten(simulation, kind)
    needs = _needs(target) if kind == MJCF else ""
    return Export(
        places[0], files, kind, diff, left, names, error, torque, kept, gone, missing, needs
    )  # fmt: skip


def _places(texts: Sequence[XmlText], into: Path, out: Path, name: str) -> tuple[Path, ...]:
    folder = into.resolve().parent
    first, *others = (out / text.path.resolve().relative_to(folder) for text in texts)
    places = (out / name if name else first, *others)
    require_apart(list(places), [text.path for text in texts])
    return places


def _needs(target: Target) -> str:
    """Say which MuJoCo has all that is in a file, and what else a reader has to know."""
    needed = target.needed_mujoco()
    if not any(wanted.slips for wanted in target.split.joints):
        return f"MuJoCo {needed} or newer" if needed else ""
    return (
        f"MuJoCo {needed} or newer; whoever sets qpos sets data.plastic as well, which keyframes "
        "here state"
    )


def _write_texts(texts: Sequence[XmlText], places: Sequence[Path], target: Target) -> None:
    """Write texts, and into keyframes what hangs on all of them."""
    _put_texts(texts, places)
    if have_changed(target):
        write_rests(texts, places[0])
        _put_texts(texts, places)


def _put_texts(texts: Sequence[XmlText], places: Sequence[Path]) -> None:
    for text, place in zip(texts, places, strict=True):
        place.parent.mkdir(parents=True, exist_ok=True)
        with whole(place) as draft:
            draft.write_text(text.text(), encoding="utf-8")


def _copy(texts: Sequence[XmlText], into: Path, out: Path, kind: str) -> list[Path]:
    """Copy meshes and textures to where the copy looks for them; a package stays where it is."""
    if kind == MJCF:
        return [x for asset in assets_of(into) if (x := _put(asset.file, out / asset.place))]
    names = [x.attributes.get("filename", "") for x in texts[0].root.walk() if x.tag == "mesh"]
    files = [into.parent / name for name in names if name and "://" not in name]
    return _copied([file for file in dict.fromkeys(files) if file.is_file()], into, out)


def _added(text: str) -> str:
    """Return the lines of a layer as those of a diff."""
    return "".join(f"+{line}" for line in text.splitlines(keepends=True))


def _gravity(simulation: Simulation, motion: Motion, stated: Sequence[float]) -> Remainder:
    """Return the size of a gravity that a file does not state."""
    body = simulation.body
    static = body.gravity_torque(motion.position)
    change = static - body.with_gravity(stated).gravity_torque(motion.position)
    rms = tuple(np.sqrt(np.mean(change**2, axis=0)).tolist())
    text = ", ".join(f"{x:.3g}" for x in body.gravity)
    return Remainder(f"gravity ({text}) m/s²", rms, "is not in the file")


def _diff(text: XmlText, place: Path) -> str:
    before, after = text.data.decode("utf-8"), text.text()
    lines = unified_diff(
        before.splitlines(keepends=True),
        after.splitlines(keepends=True),
        str(text.path),
        str(place),
        n=0,
    )
    return "".join(lines)


def _copied(files: Sequence[Path], into: Path, out: Path) -> list[Path]:
    folder, copied = into.resolve().parent, list[Path]()
    for file in files:
        if not file.resolve().is_relative_to(folder):
            raise ConfigError(
                f"names {file}, which is outside its folder; copy the model with its files to one "
                "folder",
                path=into,
            )
        copied += filter(None, [_put(file, out / file.resolve().relative_to(folder))])
    return copied


def _put(file: Path, place: Path) -> Path | None:
    """Copy a file to its place, unless that is where it lies; return where it was copied to."""
    place.parent.mkdir(parents=True, exist_ok=True)
    if place.exists() and place.samefile(file):
        return None
    shutil.copyfile(file, place)
    return place
