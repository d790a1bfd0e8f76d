"""Diagnosis of your own log: hide an effect of known size in it, and see whether it is found.

A recording of a real arm has all that no simulator has: its noise, its friction, its drives. Here
the torque of an effect, computed from the recorded motion with formulas that share no code with the
catalogue of effects, is added to the recorded torque. So the truth is known, and how much of the
held-out error the true effect makes. What the recording holds by itself is diagnosed beside it as
the case `nothing`: what is named there, too, is not counted as false.

    limo identify first.parquet --robot arm.urdf --out sim.yaml
    python benchmarks/diagnosis/conceal_on_recording.py second.parquet --sim sim.yaml --out out/own

Use a simulation that was identified on another recording, or on another part of this one. Each case
is a folder with `recording.parquet`, `heldout.parquet`, `sim.yaml` and `truth.json`; `--make` stops
there. An effect's size is the root mean square of its torque at its joint, in times the error that
the simulation has there anyhow.
"""

from __future__ import annotations

import json
import shutil
from argparse import ArgumentParser
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.errors import LimoError
from limo_driver.physics import Simulation
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.pipeline import Diagnosis
    from limo_driver.types import FloatArray

NOTHING: Final = "nothing"
SIZES: Final = (3.0, 10.0)  # times the error of the simulation
DIAGNOSED: Final = 2 / 3  # of the rows; the others are held out
SURE: Final = 0.5  # confidence from which a finding is a name
CLOSE: Final = 1.15  # times the held-out error that is left without the effect
LEAST_TRAVEL: Final = 0.1  # [rad] of a joint that effects are hidden at
LONGEST_DELAY: Final = 0.5  # [s] that torques are reported late
PROPORTIONAL: Final = 0.99  # correlation of torques that are alike
REVERSAL: Final = 0.01  # [rad/s] about which dry friction changes its sign


@dataclass(frozen=True)
class Concealed:
    """An effect that was hidden: its torque, and what may be said of it.

    Args:
        effect: Its name in the catalogue.
        joint: Where it acts, from 1; 0 for all joints.
        torque: What it adds to the recorded torque, (T, n) [N m].
        truth: Its parameters, in SI units.
        also: Names that say the same of such a recording.
    """

    effect: str
    joint: int
    torque: FloatArray
    truth: dict[str, float] = field(default_factory=dict)
    also: tuple[str, ...] = ()


class Concealer:
    """Draws effects and computes their torques from a recorded motion.

    Args:
        recording: T samples of n joints.
        simulation: What is believed of the arm; its body carries the payload.
        bandwidth: Of the filter behind which positions are differentiated [Hz].
    """

    def __init__(self, recording: Recording, simulation: Simulation, bandwidth: float) -> None:
        self.recording, self.simulation = recording, simulation
        self.motion = recording.motion(bandwidth)
        error = recording.torque - simulation.predict(recording, bandwidth)
        inner = recording.filtered(error, bandwidth)
        self.error = np.sqrt(np.mean(inner**2, axis=0))  # (n,) [N m]
        self.moving = np.flatnonzero(np.ptp(self.motion.position, axis=0) > LEAST_TRAVEL)

    def draw(self, effect: str, rng: np.random.Generator) -> Concealed:
        """Hide an effect at a joint that moves, at a size within `SIZES`."""
        j = int(rng.choice(self.moving))
        times = float(rng.uniform(*SIZES))
        return getattr(self, effect)(j, times * self.error[j], rng)

    def coulomb_friction(self, j: int, size: float, _: np.random.Generator) -> Concealed:
        """Hide dry friction."""
        tau_c, torque = _scaled(np.tanh(self.motion.velocity[:, j] / REVERSAL), size)
        also = ("stribeck_friction", "presliding_hysteresis")
        return self._at(j, "coulomb_friction", torque, {"tau_c": tau_c}, also)

    def viscous_friction(self, j: int, size: float, _: np.random.Generator) -> Concealed:
        """Hide friction that is proportional to velocity."""
        f_v, torque = _scaled(self.motion.velocity[:, j], size)
        return self._at(j, "viscous_friction", torque, {"f_v": f_v})

    def torque_offset(self, j: int, size: float, rng: np.random.Generator) -> Concealed:
        """Hide a constant."""
        offset = size * float(rng.choice((-1.0, 1.0)))
        return self._at(
            j, "torque_offset", np.full(len(self.recording), offset), {"offset": offset}
        )

    def torque_ripple(self, j: int, size: float, rng: np.random.Generator) -> Concealed:
        """Hide a ripple of the gear, of which the motion shows five periods or more."""
        position = self.motion.position[:, j]
        least = int(np.ceil(5 * 2 * np.pi / np.ptp(position)))
        order = int(rng.integers(least, 4 * least))
        wave = np.sin(order * position + rng.uniform(0, 2 * np.pi))
        amplitude, torque = _scaled(wave, size)
        return self._at(j, "torque_ripple", torque, {"amplitude": amplitude, "order": order})

    def spring_load(self, j: int, size: float, rng: np.random.Generator) -> Concealed:
        """Hide a spring that is at rest somewhere in the range of the motion."""
        position = self.motion.position[:, j]
        rest = float(rng.uniform(position.min(), position.max()))
        stiffness, torque = _scaled(position - rest, size)
        return self._at(j, "spring_load", torque, {"stiffness": stiffness, "rest": rest})

    def torque_gain(self, j: int, size: float, _: np.random.Generator) -> Concealed:
        """Hide a wrong scale of the joint's torque."""
        gain, torque = _scaled(self.recording.torque[:, j], size)
        return self._at(j, "torque_gain", torque, {"gain": gain}, ("link_inertia",))

    def time_delay(self, j: int, size: float, rng: np.random.Generator) -> Concealed:
        """Hide a torque that is reported late, by as many samples as the size asks for.

        At another joint, if no filter or network is as slow as that: slow motion hardly shows it.
        """
        times = size / self.error[j]
        for joint in (j, *rng.permutation(self.moving).tolist()):
            recorded = self.recording.torque[:, joint]
            for late in range(1, int(LONGEST_DELAY * self.recording.rate)):
                torque = np.concatenate((np.full(late, recorded[0]), recorded[:-late])) - recorded
                if np.sqrt(np.mean(torque**2)) >= times * self.error[joint]:
                    delay = late / self.recording.rate
                    return self._at(joint, "time_delay", torque, {"delay": delay})
        return self.torque_offset(j, size, rng)  # of such slow motion no delay shows

    def payload(self, j: int, size: float, rng: np.random.Generator) -> Concealed:
        """Hide a point mass at the flange, sized by the joint that feels it most for its error."""
        com = rng.uniform((-0.03, -0.03, 0.03), (0.03, 0.03, 0.12))  # [m] in the flange's frame
        torque = self._torque_of_point(com)
        felt = np.sqrt(np.mean(torque**2, axis=0)) / self.error
        mass = size / self.error[j] / float(felt.max())
        also = ("link_inertia",)
        if self.simulation.body.n == 1:  # that gravity does not load, it is the rotor's as well
            acceleration = np.gradient(self.motion.velocity[:, 0], self.motion.time)
            if abs(np.corrcoef(torque[:, 0], acceleration)[0, 1]) > PROPORTIONAL:
                also += ("armature",)
        return Concealed("payload", 0, mass * torque, {"mass": mass}, also)

    def external_contact(self, j: int, size: float, rng: np.random.Generator) -> Concealed:
        """Hide two pushes on a joint, half a sine each, in the rows that are not held out."""
        time = self.recording.time - self.recording.time[0]
        torque = np.zeros(len(time))
        for part in (0.2, 0.45):
            length = float(rng.uniform(0.4, 0.8))
            phase = (time - part * time[-1]) / length
            torque += np.where((phase > 0) & (phase < 1), np.sin(np.pi * phase), 0.0)
        return self._at(j, "external_contact", 3 * size * torque, {"peak": 3 * size})

    def _torque_of_point(self, at: FloatArray) -> FloatArray:
        """Return the torque that 1 kg at a point of the flange (3,) [m] takes, (T, n) [N m]."""
        body, motion = self.simulation.body, self.motion
        jacobian = np.empty((len(self.recording), 3, body.n))
        for k, position in enumerate(motion.position):
            arm = body.flange_pose(position)[:3, :3] @ at
            moved, turned = np.split(body.flange_jacobian(position), 2)
            jacobian[k] = moved + np.cross(turned, arm, axisa=0, axisb=0).T
        velocity = np.einsum("tij,tj->ti", jacobian, motion.velocity)
        acceleration = np.gradient(velocity, motion.time, axis=0)
        return np.einsum("tij,ti->tj", jacobian, acceleration - np.array(body.gravity))

    def _at(
        self,
        j: int,
        effect: str,
        torque: FloatArray,
        truth: dict[str, float],
        also: tuple[str, ...] = (),
    ) -> Concealed:
        added = np.zeros_like(self.recording.torque)
        added[:, j] = torque
        return Concealed(effect, j + 1, added, truth, also)


EFFECTS: Final = tuple(
    name for name in vars(Concealer) if not name.startswith("_") and name != "draw"
)


def _scaled(torque: FloatArray, size: float) -> tuple[float, FloatArray]:
    """Return the factor that gives a torque (T,) its root mean square `size`, and that torque."""
    factor = size / float(np.sqrt(np.mean(torque**2)))
    return factor, factor * torque


def conceal(recording: Recording, simulation: Simulation, hidden: Concealed, folder: Path) -> None:
    """Write a case: the recording with a hidden effect, its part to hold out, and the truth.

    Args:
        recording: T samples of n joints.
        simulation: What is believed of the arm.
        hidden: Torque to be added, and what may be said of it.
        folder: Where the files go.
    """
    folder.mkdir(parents=True, exist_ok=True)
    late = Recording.from_arrays(
        recording.time, recording.position, recording.torque + hidden.torque, recording.velocity
    )
    cut = int(DIAGNOSED * len(recording))
    late[:cut].save(folder / "recording.parquet")
    late[cut:].save(folder / "heldout.parquet")
    simulation.save(folder / "sim.yaml")
    without = simulation.score(recording[cut:]).rmse
    truth = {
        "case": folder.name,
        "kind": "truth" if hidden.effect != NOTHING else "null",
        "effects": []
        if hidden.effect == NOTHING
        else [
            {
                "effect": hidden.effect,
                "joints": [hidden.joint] if hidden.joint else [],
                "params": hidden.truth,
            }
        ],
        "accept_also": list(hidden.also),
        "tolerated": [],
        "must_not": [],
        "recordings": ["recording.parquet"],
        "heldout": ["heldout.parquet"],
        "rmse_before": simulation.score(late[cut:]).rmse.tolist(),
        "rmse_with_effect": without.tolist(),
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis said of a case."""

    truth: dict[str, Any]
    names: tuple[tuple[str, tuple[int, ...], tuple[str, ...]], ...]  # effect, joints, equivalents
    after: FloatArray  # (n,) held-out RMSE of the improved simulation [N m]
    again: tuple[str, ...]  # names of a second diagnosis, of the held-out part, at hidden joints
    seconds: float
    refused: str = ""

    @property
    def named(self) -> bool:
        """Say whether the hidden effect is named at its joint, or its equivalent."""
        return any(map(self._is_hidden, self.names))

    @property
    def closed(self) -> bool:
        """Say whether the error is as good as without the effect where that matters."""
        before, best = (np.array(self.truth[k]) for k in ("rmse_before", "rmse_with_effect"))
        matters = best < 0.85 * before
        return bool((self.after <= CLOSE * best)[matters].all()) and not self.refused

    def false(self, ordinary: Sequence[tuple[str, int]]) -> list[str]:
        """Return the names of nothing hidden, which are not named of the recording itself."""
        return [
            f"{effect} {list(joints)}"
            for effect, joints, equivalents in self.names
            if not self._is_hidden((effect, joints, equivalents))
            and not {(effect, j) for j in joints} & set(ordinary)
        ]

    def _is_hidden(self, name: tuple[str, tuple[int, ...], tuple[str, ...]]) -> bool:
        effect, joints, equivalents = name
        for item in self.truth["effects"]:
            here = not item["joints"] or set(item["joints"]) & set(joints)
            right = {item["effect"], *self.truth["accept_also"]}
            if here and (effect in right or item["effect"] in equivalents):
                return True
        return False


def run(folder: Path) -> Outcome:
    """Diagnose a case, then its held-out part with what was found."""
    from estimators.diagnosis import diagnose

    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    simulation = Simulation.load(folder / "sim.yaml")
    recording, heldout = (Recording.load(folder / truth[k][0]) for k in ("recordings", "heldout"))
    start = perf_counter()
    try:
        found = diagnose(simulation, [recording], bandwidth_for([recording], None))
    except LimoError as error:
        nothing = np.full(simulation.model.n, np.nan)
        return Outcome(truth, (), nothing, (), perf_counter() - start, str(error))
    seconds = perf_counter() - start
    found.save(folder / "found")
    names = _names(found)
    after = found.simulation.score(heldout).rmse
    try:
        second = _names(diagnose(found.simulation, [heldout], bandwidth_for([heldout], None)))
    except LimoError as error:
        again = (f"refused: {error}",)
    else:
        again = tuple(f"{effect} {list(joints)}" for effect, joints, _ in second)
    return Outcome(truth, names, after, again, seconds)


def _names(found: Diagnosis) -> tuple[tuple[str, tuple[int, ...], tuple[str, ...]], ...]:
    return tuple(
        (item.effect, item.joints, item.equivalent)
        for item in found.verdict.findings
        if item.effect != "unknown" and item.confidence >= SURE
    )


def line(case: str, outcome: Outcome, ordinary: Sequence[tuple[str, int]]) -> str:
    """Return what was hidden and what was said, in a line."""
    if outcome.refused:
        return f"{case:32} REFUSED {outcome.refused}"
    before, best = (np.array(outcome.truth[k]) for k in ("rmse_before", "rmse_with_effect"))
    worst = int(np.argmax(before / best))
    said = "named" if outcome.named else "missed"
    return (
        f"{case:32} {said:7} {'closed' if outcome.closed else 'open':7}"
        f"joint {worst + 1}: {before[worst]:.3g} -> {outcome.after[worst]:.3g} "
        f"(without: {best[worst]:.3g})  false: {', '.join(outcome.false(ordinary)) or '-'}  "
        f"second: {', '.join(outcome.again) or '-'}  {outcome.seconds:.0f} s"
    )


def main() -> None:
    """Make the cases and run them, the one with nothing hidden first."""
    options = ArgumentParser(description="hide effects of known size in a recording of your own")
    options.add_argument("recording", type=Path, help="not the one that --sim was identified on")
    options.add_argument("--sim", type=Path, required=True, help="what is believed of the arm")
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--cases", type=int, default=6, help="effects that are hidden, drawn")
    options.add_argument("--effects", nargs="*", default=EFFECTS, choices=EFFECTS)
    options.add_argument("--make", action="store_true", help="write the cases, diagnose none")
    given = options.parse_args()
    recording, simulation = Recording.load(given.recording), Simulation.load(given.sim)
    concealer = Concealer(recording, simulation, bandwidth_for([recording], None))
    rng = np.random.default_rng(given.seed)
    none = np.zeros_like(recording.torque)
    hidden = {NOTHING: Concealed(NOTHING, 0, none)}
    for k, effect in enumerate(rng.permutation(given.effects).tolist() * given.cases):
        if k == given.cases:
            break
        drawn = concealer.draw(effect, rng)
        hidden[f"{k:02}_{effect}_{drawn.joint}"] = drawn
    outcomes: dict[str, Outcome] = {}
    ordinary: list[tuple[str, int]] = []
    for case, item in hidden.items():
        folder = given.out / case
        shutil.rmtree(folder, ignore_errors=True)
        conceal(recording, simulation, item, folder)
        if given.make:
            continue
        outcomes[case] = run(folder)
        if case == NOTHING:
            ordinary = [(name, j) for name, joints, _ in outcomes[case].names for j in joints]
        print(line(case, outcomes[case], ordinary), flush=True)
    tried = [outcome for case, outcome in outcomes.items() if case != NOTHING]
    if tried:
        print(
            f"{len(tried)} hidden: {sum(o.named for o in tried)} named, "
            f"{sum(o.closed for o in tried)} closed, {sum(map(bool, (o.refused for o in tried)))} "
            f"refused, {sum(len(o.false(ordinary)) for o in tried)} false names"
        )


if __name__ == "__main__":
    main()
