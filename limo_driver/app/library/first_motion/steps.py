"""The five steps to a first motion, each with a verdict, a record and a page.

1. link and versions; 2. receive only; 3. shadow: the motions of the last two steps are planned and
computed through the safety contract, and not sent; 4. one joint, 2 degrees, at 5 % of its speed;
5. locally isotropic motion (LIMOPA) at 10 %. Nothing moves in the first three. What moves in the
last two is what was shadowed, from the same files.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from limo_driver.app.library.first_motion import watching
from limo_driver.app.library.first_motion.arms import LINK_SECONDS, RealArm
from limo_driver.app.library.first_motion.gravity import (
    NO_TORQUE,
    TOLERANCE,
    GravityJudgement,
    StillPose,
    judge_gravity,
)
from limo_driver.app.library.first_motion.motions import (
    JOINT_BEHIND,
    MOST_BEHIND,
    SLOW,
    UnexpectedMotionError,
    Watchman,
    one_joint,
    slow_limopa,
)
from limo_driver.app.library.first_motion.page import step_page
from limo_driver.app.library.first_motion.records import STEPS, Folder, Identity, description_digest
from limo_driver.app.library.first_motion.records import digest as digest_of
from limo_driver.errors import (
    BackendError,
    ConfigError,
    HoldingError,
    JointLimitError,
    PathError,
)
from limo_driver.robot.playback import Playback, PlaybackSummary
from limo_driver.robot.registry import Examination
from limo_driver.robot.robot import Robot
from limo_driver.runtime.outputs import only_writer, require_folder
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.trajectory import Trajectory
from limo_driver.types import FloatArray
from limopa import Exploring, Surroundings

MOTIONS: Final = ("one-joint", "limopa")
_FIRST: Final = 10.0  # [s] in which a first measurement has to come


@dataclass(frozen=True)
class FirstMotionSettings(Declared):
    """How the steps are done.

    Args:
        link_seconds: For which the link is examined, each way.
        watch: What is looked for while the arm is only received.
        tolerance: Of torques at rest against gravity, as a share of each joint's limit.
        joint: That moves alone, from 1; the last if 0.
        scaffolds: Poses that LIMOPA reaches and explores.
        seed: Of its plan.
        surroundings: What its plan keeps away from.
        exploring: How it explores each pose, at a tenth of the speed at most.
        fifo: Ask for SCHED_FIFO while the arm moves.
    """

    link_seconds: float = parameter("s", lower=0.0, above=True, default=LINK_SECONDS)
    watch: watching.WatchSettings = field(default_factory=watching.WatchSettings)
    tolerance: float = parameter("1", lower=0.0, upper=0.5, above=True, default=TOLERANCE)
    joint: int = parameter("", lower=0, default=0)
    scaffolds: int = parameter("", lower=1, upper=150, default=3)
    seed: int = parameter("", lower=0, default=0)
    surroundings: Surroundings = field(default_factory=Surroundings)
    exploring: Exploring = field(default_factory=lambda: Exploring(velocity=SLOW))
    fifo: bool = False


@dataclass(frozen=True)
class StepResult:
    """How a step ended."""

    record: dict[str, Any]  # as it was written
    page: Path
    found: Examination

    @property
    def passed(self) -> bool:
        """Whether the next step may come."""
        return self.found.healthy


def take_step(
    arm: RealArm,
    folder: Path | str,
    step: str | None = None,
    settings: FirstMotionSettings | None = None,
    progress: Callable[[float, int], None] | None = None,
) -> StepResult:
    """Take one step to the first motion of an arm, and write its record and its page.

    Args:
        arm: How it is described and reached.
        folder: Of the records; made if there is none.
        step: Which one; the first that has not passed if not given.
        settings: How it is done.
        progress: Told the time that an arm was received for [s], and the poses at rest so far.

    Raises:
        ConfigError: There is no such step; a step before it is missing, failed, or of another
            arm; or something that was given cannot be used. Nothing moved.
    """
    from pathlib import Path

    if step is not None and step not in STEPS:
        raise ConfigError(f"`step` is {step!r}, expected {', '.join(STEPS)}")
    kept = Folder(Path(folder))
    require_folder(kept.path, "the records of a first motion")
    with only_writer(kept.path):
        given, record = arm, kept.read(STEPS[0])
        if record is not None:
            arm = arm.complete_from(record)
        mine = _identity(arm)
        step = step or kept.next_step(mine)
        kept.require_before(step, mine)
        if step == STEPS[0]:  # the arm may be elsewhere by now
            arm = given
        taking = _Step(arm, kept, settings or FirstMotionSettings(), progress or _quiet)
        taking.check(step)
        kept.begin(step)
        found = taking.take(step)
        arm = arm.complete_from({"figures": found.figures})
        record = kept.keep(step, _identity(arm), found, taking.about)
        page = kept.file(step, ".html")
        step_page(record, arm, kept).save(page)
    return StepResult(record, page, found)


def _identity(arm: RealArm) -> Identity:
    return Identity(arm.model.name, description_digest(arm.model), arm.address)


def _quiet(_time: float, _poses: int) -> None:
    pass


class _Step:
    """Does one step of an arm."""

    def __init__(
        self,
        arm: RealArm,
        folder: Folder,
        settings: FirstMotionSettings,
        progress: Callable[[float, int], None],
    ) -> None:
        self._arm, self._folder, self._settings = arm, folder, settings
        self._progress = progress
        self.about: dict[str, Any] = {}  # settings that counted
        model = arm.model
        model.check_runnable()
        self._tolerance: FloatArray = settings.tolerance * model.limits.torque
        if not np.isfinite(self._tolerance).all():
            raise ConfigError(
                f"{model.name} states no limit of torque for every joint, of which the tolerance "
                "of torques is a share",
                path=model.urdf,
            )

    def check(self, step: str) -> None:
        """Refuse what cannot be done, before anything is opened.

        Raises:
            ConfigError: Says what.
        """
        if step in MOTIONS:
            self._shadowed(step)
        elif self._settings.joint > self._arm.model.n:
            raise ConfigError(
                f"`joint` is {self._settings.joint}, expected 1 to {self._arm.model.n}"
            )

    def take(self, step: str) -> Examination:
        """Do a step, and return what was found."""
        found = Examination()
        try:
            if step == "link":
                return self._link()
            if step == "receive":
                self._receive(found)
            elif step == "shadow":
                self._shadow(found)
            else:
                self._move(found, step)
        except ConfigError:
            raise
        except UnexpectedMotionError as error:
            found.add(error.kind, f"{error}; the arm was braked to rest")
        except HoldingError as error:
            found.add("hold", f"the arm went into a hold: {error}")
        except JointLimitError as error:
            found.add("start", str(error))
        except PathError as error:
            found.add("plan", str(error))
        except BackendError as error:
            found.add("link", str(error))
        return found

    def _link(self) -> Examination:
        seconds = self._settings.link_seconds
        self.about = {"seconds": seconds}
        return self._arm.examine(seconds)

    def _receive(self, found: Examination) -> None:
        watched = self._settings.watch
        self.about = {**vars(watched), "tolerance": self._settings.tolerance}
        with self._arm.listen() as robot:
            watch = watching.Watch(robot, watched, self._tolerance)
            try:
                watch.run(self._progress)
            except BackendError as error:
                found.add("link", str(error))
            found.figures["link"] = robot.link_figures()
            watch.judge(found)
            self._arm.judge_link(found, robot)
        if not watch.poses:
            return
        judged = judge_gravity(self._arm.model, watch.poses, self._tolerance)
        found.figures |= {
            "poses": [pose.position.tolist() for pose in judged.poses],
            "torques": [pose.torque.tolist() for pose in judged.poses],
            "gravity": judged.expected.tolist(),
            "tolerance": judged.tolerance.tolist(),
            "unseen": list(judged.unseen),
            "lightest": judged.lightest,
        }
        if self._arm.torque_needs_power and [each.kind for each in judged.causes] == [NO_TORQUE]:
            found.add(
                NO_TORQUE,
                f"{judged.causes[0].text}; before a joint moves, the torque by which the arm is "
                "held is compared",
                problem=False,
            )
            return
        if judged.unseen_mounting:
            found.add(
                "poses",
                "torques in these poses are the same where "
                f"{'; or where '.join(judged.unseen_mounting)}: they say nothing of such a "
                "mounting, so guide the arm to poses that bend it aside",
            )
        judged.judge(found, self._settings.tolerance)

    def _shadow(self, found: Examination) -> None:
        settings, model = self._settings, self._arm.model
        joint = settings.joint or model.n
        self.about = {
            "joint": joint,
            "scaffolds": settings.scaffolds,
            "seed": settings.seed,
            "surroundings": vars(settings.surroundings),
        }
        with self._arm.listen() as robot:
            start = watching.first_state(robot, _FIRST).position
        planned = {
            "one-joint": one_joint(model, start, joint),
            "limopa": slow_limopa(
                model,
                start,
                settings.scaffolds,
                settings.seed,
                settings.surroundings,
                settings.exploring,
            ),
        }
        found.figures["motions"] = motions = dict[str, Any]()
        for name, motion in planned.items():
            file = self._file(name)
            motion.save(file)
            with watching.ShadowRobot(self._arm.listen()) as shadow:
                computed = self._folder.file("shadow", f"_{name.replace('-', '_')}.parquet")
                summary = self._play(shadow, Trajectory.load(file), computed)
            motions[name] = {
                "file": file.name,
                "digest": digest_of(file.read_bytes()),
                "duration": motion.duration,
                **self._summary(summary),
            }
            self._judge_limits(found, summary, f"{name}: the contract would have changed")
        if found.healthy:
            found.add(
                "shadow",
                f"{len(planned)} motions were computed cycle by cycle from where the arm stands, "
                "and no limit changed a command; nothing was sent",
                problem=False,
            )

    def _move(self, found: Examination, step: str) -> None:
        file = self._shadowed(step)
        motion, model = Trajectory.load(file), self._arm.model
        moving = np.ptp(motion.position, axis=0) > 0
        behind = JOINT_BEHIND if step == "one-joint" else MOST_BEHIND
        self.about = {"motion": file.name, "behind": behind}
        start = motion.position[0]

        def judge(pose: StillPose) -> GravityJudgement:
            return judge_gravity(model, [pose], self._tolerance)

        if self._arm.torque_needs_power:
            judge(StillPose(start, 0.0 * start))  # compiles, which would hold up who holds the arm
        with self._arm.open() as robot:
            watchman = Watchman(model, start, moving, lambda: robot.setpoint, behind)
            record = self._folder.file(step, ".parquet")
            if self._arm.torque_needs_power:
                held = watching.hold_judged(robot, start, judge)
                held.judge(found, self._settings.tolerance)
            if not found.healthy:
                return
            try:
                summary = self._play(robot, motion, record, watchman)
            finally:
                found.figures |= {
                    "travel": watchman.travel.tolist(),
                    "torque": watchman.torque.tolist(),
                    "link": robot.link_figures(),
                }
        found.figures |= self._summary(summary)
        if summary.interrupted:
            found.add("interrupted", "the motion was interrupted, and the arm braked to rest")
            return
        self._judge_limits(found, summary, "the contract changed")
        if step == "one-joint":
            watchman.judge_travel(found, motion)
        if found.healthy:
            found.add(
                "motion",
                f"the arm moved as commanded, within {1e3 * summary.tracking_max.max():.2g} mrad, "
                "and no limit changed a command",
                problem=False,
            )

    def _play(
        self, robot: Robot, motion: Trajectory, record: Path, watchman: Watchman | None = None
    ) -> PlaybackSummary:
        playback = Playback(
            motion,
            record,
            fifo=self._settings.fifo,
            publish=None if watchman is None else watchman.look,
            provenance={"first motion": record.stem},
        )
        return playback.run(robot, lambda _done, _all: None)

    def _file(self, motion: str) -> Path:
        return self._folder.file(motion, ".traj.parquet")

    def _shadowed(self, step: str) -> Path:
        """Return the file of a motion, the very one that was shadowed.

        Raises:
            ConfigError: It is another by now, or gone.
        """
        record, file = self._folder.read("shadow") or {}, self._file(step)
        known = record.get("figures", {}).get("motions", {}).get(step, {})
        if not file.is_file() or digest_of(file.read_bytes()) != known.get("digest"):
            raise ConfigError(
                "is not the motion that was shadowed; repeat the `step` shadow", path=file
            )
        return file

    def _summary(self, summary: PlaybackSummary) -> dict[str, Any]:
        return {
            "limited": summary.limited,
            "samples": summary.samples,
            "tracking_rmse": summary.tracking_rmse.tolist(),
            "tracking_max": summary.tracking_max.tolist(),
        }

    def _judge_limits(self, found: Examination, summary: PlaybackSummary, what: str) -> None:
        if summary.limited:
            counts = ", ".join(
                f"{name.replace('_', ' ')} in {count}" for name, count in summary.limited.items()
            )
            found.add("limited", f"{what} commands: {counts} of {summary.samples} cycles")
