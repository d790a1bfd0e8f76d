"""The whole of limo, once, as real processes: each step has a figure, and a bar to hold to.

LIMOPA plans and ruckig times; an arm with hysteresis runs it; its states go over Zenoh to a
service, which estimates, logs, notices that a load was picked up, retrains, judges the challenger
and lets it serve; it is killed meanwhile and begun anew. Its log is diagnosed: load and worn joint
have values, whose intervals hold; what was found explains another motion, and goes into a file.
"""

from __future__ import annotations

from contextlib import ExitStack
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from limo_driver.app.library.whole import plant
from limo_driver.app.library.whole.explaining import (
    BANDWIDTH,
    Proof,
    Step,
    count_unanswered,
    judge_explanation,
    judge_export,
    judge_finding,
    read_log,
)
from limo_driver.app.library.whole.processes import (
    RATE,
    Consumer,
    ProvenWire,
    ServiceProcess,
    configurations,
    moving,
    recorded,
    wire_of,
)
from limo_driver.errors import LimoError
from limo_driver.network.streaming import open_session
from limo_driver.runtime.plugins import require_package

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from estimators.diagnosis.from_torque.pipeline import Diagnosis
    from limo_driver.app.library.whole.processes import HeardStates
    from limo_driver.physics import Simulation

PUSH_BAR: Final = 0.05  # of the push
_SETTLED: Final = 0.4  # [s] at either end of a push, in which the filter mixes it with none
_AFTER: Final = 4 * RATE  # estimates after a swap that are looked at
_CONTACT: Final = 8.0  # [N m], which a load of this size is not
_SCAFFOLDS: Final = 8, 60, 2  # poses of the motions to train on, to stream, and of the other one
# Motion [s] that shows how large the residual usually is, to learn a challenger from (about four
# poses: after one it is worse elsewhere, at joints of which that pose tells little), to judge it on
_REFERENCE, _GATHERED, _SHADOW = 40.0, 90.0, 50.0
_LOGGED: Final = 2 * RATE  # estimates by which a log may be behind
_NANOSECONDS: Final = 1e9


def prove(
    out: Path,
    backend: str = "mujoco",
    progress: Callable[[str, float], None] | None = None,
) -> Proof:
    """Go the whole way once.

    Args:
        out: Folder of all that it leaves; it has to be there.
        backend: By which the driver reaches the arm: mujoco, fri or can.
        progress: Told what is being done, and the part that is done.

    Returns:
        What came of each step; where one cannot be done, those before it and why.

    Raises:
        ConfigError: No such backend.
        MissingPackageError: The package `river` is not installed.
    """
    require_package("river", "detection of drift")
    wire = wire_of(backend, out)
    proof, began = Proof(wire), monotonic()
    run = _Run(out, wire, proof, progress or (lambda _text, _part: None))
    try:
        run.all()
    except LimoError as error:
        proof.failure = str(error)
    proof.seconds = monotonic() - began
    return proof


class _Run:
    """One way through all of it."""

    def __init__(
        self,
        out: Path,
        wire: ProvenWire,
        proof: Proof,
        tell: Callable[[str, float], None],
    ) -> None:
        self.out, self.wire, self.proof, self.tell = out, wire, proof, tell
        self.believed, self.arm = plant.believed(), plant.true_arm()
        self.motions = [out / f"{name}.traj.parquet" for name in ("train", "stream", "other")]

    def all(self) -> None:
        """Do one step after the other."""
        self.plan()
        self.learn()
        with ExitStack() as open_:
            self.serve(open_)
            self.feel_push("Push before the swap", self.arm, "before")
            until = self.relearn()
            loaded = plant.loaded(self.arm)
            self.feel_push("Push after the swap", loaded, "after")
            heard = self.consumer.heard()
            self.proof.felt.append((heard.stamps, heard.external))
        self.diagnose(until, loaded)

    def held(self, name: str, figure: str, bar: str, *, held: bool) -> None:
        """Note what came of a step."""
        self.proof.steps.append(Step(name, figure, bar, held))

    def plan(self) -> None:
        """Plan three motions."""
        from limo_driver.app.library.moving import plan
        from limopa import PlanRequest

        self.tell("planning three motions", 0.0)
        limits, worst, seconds = self.believed.model.limits, 0.0, 0.0
        for seed, (poses, path) in enumerate(zip(_SCAFFOLDS, self.motions, strict=True), start=11):
            motion = plan(plant.ROBOT, PlanRequest(scaffolds=poses), seed=seed).trajectory
            motion.save(path)
            worst = max(
                worst,
                float((np.abs(motion.velocity) / limits.velocity).max()),
                float((np.abs(motion.acceleration) / limits.acceleration).max()),
            )
            seconds += float(motion.time[-1])
        self.held(
            "LIMOPA plans, ruckig times",
            f"{seconds:.0f} s of motion, at {worst:.2f} of the limits at most",
            "1 of the limits",
            held=worst <= 1.0,
        )

    def written(self, name: str, arm: Simulation) -> Path:
        """Write an arm into a file."""
        path = self.out / f"{name}.yaml"
        arm.save(path)
        return path

    def learn(self) -> None:
        """Record the arm without load, and put what is learned of it into a store."""
        from estimators.service.store.store import ModelStore
        from limo_driver.app.library.learning import train
        from limo_driver.recordings.recording import Recording

        self.tell(f"recording the arm over {self.wire.name}", 0.03)
        record = self.out / "train.parquet"
        with moving(self.wire, self.written("arm", self.arm), self.motions[0], record) as driver:
            recording = Recording.load(recorded(driver, record))
        self.tell("learning from it", 0.1)
        train(self.believed, [recording], bandwidth=BANDWIDTH).save(self.out / "model")
        store = ModelStore(self.out / "models")
        store.add(self.out / "model", golden=recording)
        store.promote(1, "learned without load")

    def serve(self, open_: ExitStack) -> None:
        """Start the service and what hears it, until everything closes."""
        from estimators.service.settings import RetrainingSettings, ServiceSettings

        here, self.network = configurations(self.out)
        self.consumer = open_.enter_context(
            Consumer(open_.enter_context(open_session(config=here)))
        )
        self.options: dict[str, Any] = {
            "store": self.out / "models",
            "log": self.out / "logs",
            "config": self.network,
            "fifo": bool(self.wire.other_end),
            "settings": ServiceSettings(contact_torque=_CONTACT),
            "retraining": RetrainingSettings(
                seconds=_GATHERED, shadow=_SHADOW, reference=_REFERENCE
            ),
        }
        self.service = ServiceProcess(self.options)
        open_.callback(lambda: self.service.close())  # noqa: PLW0108  # whichever it is by then

    def feel_push(self, name: str, arm: Simulation, file: str) -> None:
        """Stream until a push was felt from its beginning to its end."""
        self.tell(f"{name.lower()}: {plant.PUSH:g} N m", self.part)
        consumer, first, known = self.consumer, self.consumer.count, len(self.consumer.events)
        sim, record = (
            self.written(f"pushed_{file}", plant.pushed(arm)),
            self.out / f"{file}.parquet",
        )
        with moving(self.wire, sim, self.motions[1], record, self.network) as driver:
            ended = consumer.wait(
                lambda: next(
                    (
                        event
                        for event in consumer.events[known:]
                        if event.kind == "contact_end"
                        and event.facts["joint"] == 1
                        and event.facts["lasted"] > plant.LONG - _SETTLED
                        and not event.facts["cut_off"]
                    ),
                    None,
                ),
                (driver, self.service.process),
            )
        heard, margin = consumer.heard(first), round(_SETTLED * _NANOSECONDS)
        begin = ended.facts["began_stamp"] + margin
        end = ended.facts["ended_stamp"] - margin
        rows = (heard.stamps >= begin) & (heard.stamps <= end)
        positions = consumer.positions(begin, end)
        if not rows.any() or not len(positions):
            raise LimoError(f"no estimates came while the arm was pushed: {ended.text}")
        felt = np.nanmean(heard.external[rows], axis=0)
        flange = [self.believed.model.flange_jacobian(position) for position in positions]
        made = -np.mean([jacobian.T @ plant.WRENCH for jacobian in flange], axis=0)
        off = np.abs(felt - made) / plant.PUSH
        worst = int(np.argmax(off))
        self.held(
            name,
            f"{abs(felt[0]):.2f} N m at joint 1; the worst joint is {worst + 1}, "
            f"{off[worst]:.1%} of the push off",
            f"{PUSH_BAR:.0%} of {plant.PUSH:g} N m, every joint",
            held=bool(off[worst] <= PUSH_BAR),
        )

    @property
    def part(self) -> float:
        """The part of the steps that is done."""
        return min(0.15 + 0.07 * len(self.proof.steps), 0.95)

    def relearn(self) -> int:
        """Pick up a load while it streams, and wait until a challenger that knows it is promoted.

        Returns:
            Stamp of the last estimate [ns].
        """
        consumer, known = self.consumer, len(self.consumer.events)
        arm = self.written("picking_up", plant.loaded(self.arm, 0.8 * _REFERENCE))
        self.tell("streaming until the load is noticed", self.part)
        record = self.out / "stream.parquet"
        with moving(self.wire, arm, self.motions[1], record, self.network) as driver:
            living = driver, self.service.process
            drift = consumer.wait(lambda: consumer.event("drift", known), living)
            consumer.wait(lambda: self.stage("gathering"), living)
            self.kill(drift.facts["joints"])
            living = driver, self.service.process
            self.tell("retraining from the log", self.part)
            trained = consumer.wait(lambda: consumer.event("trained", known), living)
            self.tell("judging the challenger against the champion", self.part)
            promoted = consumer.wait(
                lambda: consumer.event("promoted", known) or consumer.event("refused", known),
                living,
            )
            if promoted.kind != "promoted":
                raise LimoError(f"the challenger does not serve: {promoted.text}")
            after = consumer.count
            consumer.wait(lambda: (consumer.count > after + _AFTER) or None, living)
        heard = consumer.heard(self.restarted)
        self.judge_swap(trained.facts["metrics"], heard)
        return int(heard.stamps[-1])

    def stage(self, name: str) -> bool | None:
        """Say whether the service says that retraining is at a stage."""
        return self.consumer.status.get("retraining", {}).get("stage") == name or None

    def kill(self, joints: list[int]) -> None:
        """Kill the service, begin it anew, and wait until it answers."""
        consumer = self.consumer
        self.held(
            "Drift is noticed: a load was picked up",
            f"joint {', '.join(map(str, joints))}",
            f"of joints {', '.join(map(str, plant.CARRYING))}, which lift it",
            held=not set(joints).isdisjoint(plant.CARRYING),
        )
        self.tell("killing the service, and starting it again", self.part)
        self.service.kill()
        consumer.forget_status()
        self.restarted, began = consumer.count, monotonic()
        self.service = ServiceProcess(self.options)
        first = consumer.wait(
            lambda: (consumer.count > self.restarted) or None, (self.service.process,)
        )
        living = (self.service.process,)
        stage = consumer.wait(lambda: self.stage("gathering") or self.stage("training"), living)
        self.held(
            "The service is killed (SIGKILL) and comes back",
            f"answers after {monotonic() - began:.1f} s, and goes on with what it was gathering",
            "goes on",
            held=bool(first and stage),
        )

    def judge_swap(self, metrics: dict[str, Any], heard: HeardStates) -> None:
        """Say how the challenger compares, and what the swap cost."""
        ratio = metrics["against_champion"]["mean_ratio"]["value"]
        self.held(
            "Retrained and judged: squared error over the champion's, on motion held out",
            f"{ratio:.3f}",
            "below 1",
            held=ratio < 1.0,
        )
        models = np.array(heard.models)
        swaps = np.flatnonzero(models[1:] != models[:-1]) + 1
        span = int(heard.stamps[0]), int(heard.stamps[-_LOGGED])
        lost = count_unanswered(self.out / "logs", self.options["settings"].delay, *span)
        gap = (
            int(heard.sequences[swaps[0]] - heard.sequences[swaps[0] - 1]) - 1 if swaps.size else -1
        )
        self.held(
            "Swapped in flight: states taken and not answered; missing for the consumer",
            f"{lost}; {gap}",
            "0; 0",
            held=lost == 0 and gap == 0,
        )

    def diagnose(self, until: int, loaded: Simulation) -> None:
        """Diagnose the log of the arm with its load, and prove what is found."""
        from limo_driver.app.library.diagnosing import diagnose
        from limo_driver.recordings.recording import Recording

        self.tell("diagnosing the log", self.part)
        joints = tuple(self.believed.model.joint_names)
        since = int(self.consumer.heard(self.restarted).stamps[0])
        log = read_log(self.out / "logs", joints, since, until)
        log.save(self.out / "logged.parquet")
        found = cast("Diagnosis", diagnose(self.believed, log))
        found.save(self.out / "diagnosis")
        load, worn = plant.LOAD, plant.WORN
        dry = plant.friction_of(self.arm, worn.joint)
        self.proof.steps += [
            judge_finding("The load is named", found, load.name, "mass", load.mass),
            judge_finding(f"The worn joint {worn.joint} is named", found, worn.name, "tau_c", dry),
        ]
        self.tell("moving the arm along another motion", self.part)
        record = self.out / "other.parquet"
        with moving(self.wire, self.written("loaded", loaded), self.motions[2], record) as driver:
            other = Recording.load(recorded(driver, record))
        self.tell("explaining it with what was found", self.part)
        self.proof.steps.append(judge_explanation(found.simulation, loaded, other))
        self.tell("exporting into a file", self.part)
        self.proof.steps.append(judge_export(found.simulation, self.believed, self.out))
