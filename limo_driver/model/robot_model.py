"""RobotModel: kinematics, inertias, limits and collision bodies of an arm from URDF or MJCF."""

# pinocchio has no stubs and is found through an import hook; this file is the adapter to it.
# pyright: reportMissingImports=false, reportUnknownParameterType=false

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from importlib.resources import files
from os.path import isfile  # says no, too, of a name that no file can have
from pathlib import Path

import numpy as np
import pinocchio as pin

from limo_driver.errors import ConfigError, ShapeError
from limo_driver.model.descriptions.chain import (
    frames_alone,
    frames_of_joint,
    is_nearly_possible,
    joint_limits,
    last_frame,
    link_of_joint,
    read_chain,
    unstated_limits,
    with_drives_apart,
)
from limo_driver.model.descriptions.description import SITE, joined_reference, split_reference
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.model.descriptions.reading import read_description
from limo_driver.model.descriptions.shapes import (
    ArmShapes,
    Capsule,
    doubts_about_description,
    read_shapes,
)
from limo_driver.model.dynamics import ArmDynamics
from limo_driver.runtime.display import Displayed, shortened
from limo_driver.types import FloatArray, Motion, as_numbers

BUILT_IN = ("iiwa14",)
_MOST_NEGATIVE = 0.5  # of the largest principal moment, that a negative one may still be a slip
_ROOM = 1.5  # times a motion that was made, up to which a faster one is allowed
_GRAIN = 1e-6  # [m], extent below which a moment of inertia is rounding
_MORE = ", of which one is above the sum of the others"


def beside(robot: str, folder: Path) -> str:
    """Return a robot as a file in a folder names it: built in, or a file, sought there first."""
    path, joints = split_reference(robot)
    file = folder / path
    if robot in BUILT_IN or not isfile(file):
        return robot
    return joined_reference(str(file.resolve()), joints)


class RobotModel(ArmDynamics, Displayed):
    """Rigid-body model of an arm with n joints that turn or slide.

    Of a joint that slides, positions are in m and torques are forces in N, wherever limo says rad
    and N m. A joint that follows another moves with it, q = ratio q_leader + offset, and is none of
    the n; the links that it moves are among those of `linkage`. Joints that are not chosen and, if
    none is chosen, those that slide at the end of the arm (a gripper's) are locked with what
    follows them, and their bodies added to the link that carries them. A continuous joint has
    limits of half a turn to either side, within which motion is planned; recordings may count any
    number of turns. Masses may be left out: motion is planned, run and looked at without, and what
    computes torques refuses (`massless`).

    Of an MJCF file the arm is the tree of bodies with the most hinges. What a file states beside
    the rigid body (friction, damping, armature, springs) is in `description`; a `Simulation` that
    is loaded from the file has it as effects.

    Args:
        urdf: URDF or MJCF file.
        name: Name by which files refer to the robot; the path if not given.
        inertials: Inertias that replace those of the URDF, by link name.
        gravity: In the frame of the base [m/s²]; the file's if not given, -z in a URDF.
        joints: Names or patterns of the joints that move, and `name=position` of joints locked
            elsewhere than as near to zero as they can be; all that can move if none is given.

    Raises:
        ConfigError: The file is missing, is neither, has no joint that moves or none of these
            names, an inertial names no moving link or no possible body; or gravity is not finite.
        ShapeError: The gravity is not (3,).

    Example:
        >>> arm = limo.RobotModel.load("iiwa14")
        >>> arm.gravity_torque(np.zeros((1, arm.n)))
    """

    def __init__(
        self,
        urdf: Path | str,
        name: str | None = None,
        inertials: Mapping[str, Inertial] | None = None,
        gravity: Sequence[float] | None = None,
        joints: Sequence[str] = (),
    ) -> None:
        self.urdf, self.chosen = Path(urdf), tuple(joints)
        self.name = name or joined_reference(str(urdf), self.chosen)
        if not isfile(self.urdf):
            raise ConfigError("no such URDF or MJCF file", path=urdf)
        self.description = read_description(self.urdf, self.chosen)
        chain = read_chain(self.description)
        self.pin_model, self.locked_joints = chain.model, chain.locked
        # m links, each with a joint of its own, and which of the n joints moves it
        self.pin_tree, self.linkage = chain.tree, chain.linkage
        self.joint_names: tuple[str, ...] = chain.names
        self.link_joints: tuple[str, ...] = chain.link_joints  # (m,), those that follow as well
        self.link_names: tuple[str, ...] = tuple(
            link_of_joint(self.pin_tree, link + 1) for link in range(self.linkage.links)
        )
        self.inertials: dict[str, Inertial] = {
            link: Inertial.of_pinocchio(self.pin_model.inertias[j + 1])
            for j, link in enumerate(self.link_names)
        }
        apart, driven = with_drives_apart(
            self.description, self.pin_tree, self.inertials, chain.link_joints
        )
        self.inertials |= apart
        self._frames = frames_alone(self.pin_tree, self.description)
        _check_moments(self.inertials, chain.link_joints, self.urdf)
        rounded = self._with_real_bodies(apart)
        self._override(inertials or {})
        given = self.description.gravity if gravity is None else gravity
        self.pin_model.gravity.linear = self.pin_tree.gravity.linear = _gravity(given)
        assumed = self.description.kind == "MJCF"
        # joints that slide along their axis, in m and N
        self.sliding: tuple[bool, ...] = chain.sliding
        self.jerk = self.description.jerk_of(self.joint_names)  # (n,) [rad/s^3], or None
        self.limits = joint_limits(chain, self.jerk, self.urdf, assumed=assumed)
        # joints whose speed the file does not limit; what `limits` has of it is chosen for plans
        stated = np.array(chain.tree.upperVelocityLimit)[chain.linkage.own]
        self.unlimited_speed = assumed & (stated <= 0.0)
        self._flange = last_frame(self.pin_tree, self.linkage.links)
        locked = (
            f"joint {x} neither turns nor slides, and is locked at 0" for x in self.locked_joints
        )
        unstated = unstated_limits(self.pin_model, self.joint_names, self.sliding, assumed=assumed)
        slides = (
            f"joint {x} slides: its positions are in m, its torques are forces in N"
            for x, each in zip(self.joint_names, self.sliding, strict=True)
            if each
        )
        doubts = doubts_about_description(
            self.description,
            self.joint_names,
            self.limits.position_min,
            self.limits.position_max,
            self.sliding,
        )
        lacking = (self._massless(),) if self.massless else ()
        told = (
            *(*self.description.notes, *locked, *slides, *unstated),
            *(*driven, *rounded, *lacking, *doubts),
        )
        self.notes: tuple[str, ...] = told
        # joints without ends; their limits say within which turn motion is planned, no more
        self.turning: tuple[bool, ...] = tuple(x in chain.turning for x in self.joint_names)

    @classmethod
    def load(
        cls, source: str | Path, inertials: Mapping[str, Inertial] | None = None
    ) -> RobotModel:
        """Load a built-in robot by name, or any robot from a URDF or MJCF file.

        Args:
            source: Built-in name, or path of a URDF or MJCF; `arm.urdf#joint*,finger=0.02` are the
                joints of it that match, with the finger locked there and all others as near to
                zero as they can be.
            inertials: Inertias that replace those of the file, by link name.

        Raises:
            ConfigError: Neither a built-in name nor a file.
        """
        if str(source) in BUILT_IN:
            path = files("limo_driver") / "assets" / f"{source}.urdf"
            return cls(str(path), name=str(source), inertials=inertials)
        path, joints = split_reference(str(source))
        if not isfile(path):
            raise ConfigError(
                f"robot {str(source)!r} is neither built in ({', '.join(BUILT_IN)}) nor a URDF file"
                " nor an MJCF file"
            )
        return cls(path, inertials=inertials, joints=joints)

    def with_inertials(self, inertials: Mapping[str, Inertial]) -> RobotModel:
        """Return this robot with some inertias replaced.

        Args:
            inertials: The new ones by link name; the others stay.

        Raises:
            ConfigError: There is no such moving link, or no such body.
        """
        return self._changed(inertials, self.gravity)

    def with_gravity(self, gravity: Sequence[float]) -> RobotModel:
        """Return this robot under another gravity.

        Args:
            gravity: (3,) [m/s²] in the frame of the base.

        Raises:
            ConfigError: It is no array of finite numbers.
            ShapeError: It is not (3,).
        """
        return self._changed({}, gravity)

    def with_joints(self, joints: Sequence[str]) -> RobotModel:
        """Return the robot of this file with other joints chosen, and the inertias of the file.

        Args:
            joints: Names or patterns of the joints that move, and `name=position` of those that
                are locked there.

        Raises:
            ConfigError: There is no joint of these names.
        """
        return RobotModel(self.urdf, gravity=self.gravity, joints=joints)

    def allowing(self, motion: Motion) -> RobotModel:
        """Return this robot, as fast as a motion where its file does not say how fast it is.

        Args:
            motion: That an arm has made, T samples.
        """
        if not self.unlimited_speed.any():
            return self
        other, limits = copy(self), self.limits
        jerk = np.gradient(motion.acceleration, motion.time, axis=0)
        made = {"velocity": motion.velocity, "acceleration": motion.acceleration, "jerk": jerk}
        other.limits = replace(limits, **{
            name: np.where(
                self.unlimited_speed,
                np.maximum(getattr(limits, name), _ROOM * np.abs(values).max(axis=0)),
                getattr(limits, name),
            )
            for name, values in made.items()
        })  # fmt: skip
        return other

    def _changed(self, inertials: Mapping[str, Inertial], gravity: Sequence[float]) -> RobotModel:
        """Return a copy: reading the file again takes longer than what the copy is made for."""
        other = copy(self)
        vars(other).pop("_weightless", None)
        other.pin_model = self.pin_model.copy()
        is_plain = self.pin_tree is self.pin_model
        other.pin_tree = other.pin_model if is_plain else self.pin_tree.copy()
        other.inertials = dict(self.inertials)
        other._override(inertials)
        other.pin_model.gravity.linear = other.pin_tree.gravity.linear = _gravity(gravity)
        return other

    @property
    def gravity(self) -> tuple[float, ...]:
        """Gravity in the frame of the base [m/s²]."""
        return tuple(np.array(self.pin_model.gravity.linear).tolist())

    @property
    def length(self) -> float:
        """Distance from axis to axis, summed from the base to the last joint [m]."""
        placements = list(self.pin_tree.jointPlacements)[1:]
        return float(sum(np.linalg.norm(np.array(item.translation)) for item in placements))

    def headline(self) -> str:
        """Say its name, joints and mass."""
        mass = sum(body.mass for body in self.inertials.values())
        return f"{self.name}, {self.n} joints, {mass:.4g} kg that move"

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the limits of each joint."""
        limits = self.limits
        return {
            "joint": self.joint_names,
            "from [rad]": limits.position_min.tolist(),
            "to [rad]": limits.position_max.tolist(),
            "velocity [rad/s]": limits.velocity.tolist(),
            "torque [N m]": limits.torque.tolist(),
        }

    def whole_turns(self, position: FloatArray) -> FloatArray:
        """Return the whole turns that joints without ends have made.

        Args:
            position: (..., n) [rad].

        Returns:
            Multiples of 2π (..., n) [rad]; without them the same pose is within half a turn.
        """
        return np.where(self.turning, 2 * np.pi * np.round(position / (2 * np.pi)), 0.0)

    @property
    def flange(self) -> str:
        """Name of the frame farthest along the links fixed to the last one, or called so."""
        return str(self.pin_tree.frames[self._flange].name.removeprefix(SITE))

    @property
    def last_frames(self) -> dict[str, FloatArray]:
        """Frames fixed to the last link, poses (4, 4) in that of this link, by name.

        The link itself, links that are fixed to it, and sites of an MJCF file.
        """
        return frames_of_joint(self.pin_tree, self.linkage.links)

    @cached_property
    def shapes(self) -> ArmShapes:
        """The collision shapes: of a mesh its convex hull, and a capsule around each.

        Raises:
            ConfigError: A collision mesh that the description names is not there.
        """
        return read_shapes(self.description, self.pin_model)

    def check_masses(self) -> None:
        """Refuse an arm whose torques cannot be computed.

        Raises:
            ConfigError: A link has no mass.
        """
        if self.massless:
            raise ConfigError(self._massless(), path=self.urdf)

    def _massless(self) -> str:
        links = self.massless
        joint = self.link_joints[self.link_names.index(links[0])]
        who = f"link {links[0]}, which joint {joint} moves, has"
        if len(links) > 1:
            who = f"{len(links)} links that move, {shortened(links)}, have"
        return (
            f"{who} no mass: motion can be planned and run, and torques are computed only once "
            f"<inertial> is stated of {'each' if len(links) > 1 else 'it'}"
        )

    def check_runnable(self) -> None:
        """Refuse an arm that cannot be run.

        Raises:
            ConfigError: A joint has no limit of velocity or torque: it could not move, or would be
                told no torque that carries it; or it states no range, and would meet its stops.
        """
        self.check_ranges()
        for what, limits in (("velocity", self.limits.velocity), ("torque", self.limits.torque)):
            for j, most in enumerate(limits.tolist()):
                if not most > 0:
                    raise ConfigError(
                        f"joint {j + 1} ({self.joint_names[j]}) has no limit of {what}, so the arm "
                        f"cannot be run: give it one in the {self.description.kind}"
                    )

    def check_ranges(self) -> None:
        """Refuse to move an arm whose description leaves ranges out, for which some are made up.

        Raises:
            ConfigError: A joint has limits of 0 to 0, as exporters leave them, or reversed.
        """
        if unranged := self.description.unranged:
            raise ConfigError(
                f"the limits of {shortened(unranged)} are 0 to 0 or reversed, so nobody knows how "
                f"far the arm may go: state them in the {self.description.kind}, or the type "
                "continuous",
                path=self.urdf,
            )

    def capsules(self) -> tuple[Capsule, ...]:
        """Return the collision capsules; other shapes get one around them.

        Raises:
            ConfigError: A collision mesh that the description names is not there.
        """
        return self.shapes.capsules

    def reference(self, folder: Path) -> str:
        """Return how a file refers to this robot: built-in name or relative path.

        Args:
            folder: Of that file.
        """
        if self.name in BUILT_IN:
            return self.name
        path = Path(os.path.relpath(self.urdf.resolve(), folder.resolve())).as_posix()
        return joined_reference(path, self.chosen)

    def _with_real_bodies(self, changed: Mapping[str, Inertial]) -> tuple[str, ...]:
        """Put the nearest rigid body in the place of each that is none; return what to say.

        Files have such, of roundings, of tensors about another point, and of mistakes. A slow arm
        hardly feels them, so that masses and centres of mass are worth going on with.

        Args:
            changed: Links that are not as the file has them, by name; nothing more is said of them.
        """
        massive = {name: body for name, body in self.inertials.items() if body.mass > 0}
        nearly = {name: body for name, body in massive.items() if not body.has_extent()}
        real = {name: body.nearest_consistent() for name, body in nearly.items()}
        self._override({**{x: y.nearest_consistent() for x, y in changed.items()}, **real})
        return tuple(
            f"link {name} has the principal moments of inertia {_principal(body)} kg m²"
            + (", those of a body without any width" if body.is_possible() else _MORE)
            + f"; the nearest body that exists is taken, with {_principal(self.inertials[name])}"
            + (
                ""
                if body.is_possible() or is_nearly_possible(body)
                else ". So far off, is it a mistake in the file?"
            )
            for name, body in nearly.items()
            if name not in changed
        )

    def _override(self, inertials: Mapping[str, Inertial]) -> None:
        for link, inertial in inertials.items():
            if link not in self.link_names:
                raise ConfigError(
                    f"robot {self.name} has no moving link {link!r}; "
                    f"it has {', '.join(self.link_names)}"
                )
            if not inertial.is_consistent():
                raise ConfigError(
                    f"no rigid body has the mass {inertial.mass:g} kg and inertia given for {link}"
                )
            for each in (self.pin_model, self.pin_tree):
                each.inertias[self.link_names.index(link) + 1] = pin.Inertia(
                    inertial.mass, np.array(inertial.com), inertial.tensor()
                )
            self.inertials[link] = inertial
        # links that move and state no mass, but for frames between axes, which need none
        self.massless: tuple[str, ...] = tuple(
            name
            for name, body in self.inertials.items()
            if body.mass <= 0 and name not in self._frames
        )


def _check_moments(
    inertials: Mapping[str, Inertial], joint_names: Sequence[str], path: Path
) -> None:
    """Refuse moments of inertia that nothing explains.

    Rods and point masses have none about an axis, and a small one is negative where products of
    inertia were rounded or got another sign: the nearest body stands for them.
    """
    for (link, body), joint in zip(inertials.items(), joint_names, strict=True):
        least, _, most = np.linalg.eigvalsh(body.tensor()).tolist()
        if body.mass <= 0 or abs(least) <= body.mass * _GRAIN**2:
            continue
        if least < -_MOST_NEGATIVE * most or most < 0:
            raise ConfigError(
                f"link {link}, which joint {joint} moves, has the principal moments of inertia "
                f"{_principal(body)} kg m²; expected those of a body, above 0",
                path=path,
            )


def _principal(body: Inertial) -> str:
    return ", ".join(f"{moment:.4g}" for moment in np.linalg.eigvalsh(body.tensor()).tolist())


def _gravity(gravity: Sequence[float]) -> FloatArray:
    """Return a gravity (3,) [m/s²], checked."""
    array = as_numbers("gravity", gravity)
    if array.shape != (3,):
        raise ShapeError("gravity", array.shape, "(3,)")
    if not np.isfinite(array).all():
        raise ConfigError(f"gravity is {array.tolist()} m/s², expected finite numbers")
    return array
