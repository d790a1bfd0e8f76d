"""Concealed cases: recordings of a plant that has more in it than the nominal model says.

A case is two recordings to diagnose and two held-out recordings of other motions, all drawn from
one integer seed. What is hidden, and how large it is, goes into a folder that a diagnosis is not
given.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import arm as arm_
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import size
import yaml
from acquisition import Instruments, Recorded
from draft import Draft, Place
from known_effects import KNOWN, LATER
from other_effects import UNKNOWN, WRONG
from variant import ROBOT, USUAL, Variant
from world import FRICTION, INERTIA, World

KINDS = ("single", "set", "unknown", "wrong_parameter", "null")
SIZES = (1.0, 3.0, 10.0)
_SHARES = (0.5, 0.2, 0.1, 0.1, 0.1)  # of the kinds, when none is asked for
_ALONE = (  # of each group, at most one in a set: together they could not be told apart
    {"joint_elasticity", "backlash", "encoder_offset"},
    {"link_inertia", "payload", "gravity_direction"},
    {"torque_offset", "torque_drift", "asymmetric_friction", "spring_load"},
    {"torque_gain", "torque_crosstalk"},
    {"coulomb_friction", "stribeck_friction", "presliding_hysteresis"},
    {"viscous_friction", "quadratic_drag", "time_delay"},
)
_CLOSE = 0.06  # relative, of a size to what was asked for
_TRIES = 8  # joints tried before a size is given up


class UnreachableError(RuntimeError):
    """No plausible amplitude gives the size asked for."""


@dataclass(frozen=True)
class Hidden:
    """One hidden effect with its amplitude."""

    draft: Draft
    amplitude: float
    sizes: np.ndarray  # (n,)

    def as_dict(self, nominal: dict) -> dict:
        """Return everything about it.

        Args:
            nominal: The simulation file handed over, in which a value may be wrong.
        """
        d = self.draft
        described = {
            "effect": d.effect, "kind": d.kind, "joints": list(d.joints), "law": d.law,
            "equivalent": list(d.equivalent), "amplitude": float(self.amplitude),
            "parameters": d.parameters(self.amplitude), "foretellable": d.predictable,
            "size": float(self.sizes.max()), "sizes": [round(float(s), 3) for s in self.sizes],
            "most_affected": int(self.sizes.argmax()) + 1,
        }  # fmt: skip
        return described | ({"wrong": self._wrong(nominal)} if d.wrong else {})

    def _wrong(self, nominal: dict) -> dict:
        """Return which value is wrong, and by how many sigmas of its tolerance."""
        name, joint = self.draft.wrong, self.draft.joints[0]
        if self.draft.effect == "link_inertia":
            stated, tolerance = nominal["inertials"][f"link{joint}"][name], INERTIA
        else:
            entries = [e for e in nominal["effects"] if e.get("joint") == joint]
            entry = next(e for e in entries if e["effect"] == self.draft.effect)
            stated, tolerance = entry[name], FRICTION
        true = self.draft.parameters(self.amplitude)[name]
        off = (true / stated - 1) / tolerance
        return {"parameter": name, "true": true, "nominal": stated, "sigmas": off}


@dataclass(frozen=True)
class Case:
    seed: int
    kind: str
    drawn_as: str | None  # the kind asked for
    only: str | None  # the effect asked for
    nominal: dict  # the simulation file handed over
    recordings: tuple[Recorded, ...]  # two to diagnose, then two held out
    hidden: tuple[Hidden, ...]
    floor: np.ndarray  # (n,) [N m] below 10 Hz, over moving rows
    instruments: Instruments
    segments: tuple[list[str], ...]
    asked: tuple[float, ...]  # sizes
    skipped: int  # draws whose size could not be reached
    temperature: bool
    world: World
    variant: Variant

    def answer(self, motion: np.ndarray, path: Path) -> None:
        """Record one more motion, given every millisecond, (T, n) [rad], into a file."""
        motion = self.variant.whole(motion)
        response = self.world.respond(motion, 4, np.random.default_rng([self.seed, 4]))
        table = self._table(self.instruments.record(response, self.world.sensing, 4))
        pq.write_table(table, path)

    def write(self, folder: Path) -> None:
        """Write what a diagnosis is given, and beside it what it is not."""
        hidden = folder / "hidden"
        hidden.mkdir(parents=True, exist_ok=True)
        nominal = self.nominal
        if not self.variant.usual:
            nominal, robot = self.variant.simulation(nominal)
            (folder / ROBOT).write_text(robot)
        (folder / "sim.yaml").write_text(yaml.safe_dump(nominal, sort_keys=False))
        for k, recorded in enumerate(self.recordings):
            name = f"recording_{k + 1}" if k < 2 else f"held_out_{k - 1}"
            pq.write_table(self._table(recorded), folder / f"{name}.parquet")
            if k >= 2:
                np.savez_compressed(
                    hidden / f"{name}.npz", torque=self.variant.recorded(recorded).clean
                )
        (hidden / "truth.json").write_text(json.dumps(self.truth(), indent=1))

    def truth(self) -> dict:
        return {
            "seed": self.seed, "kind": self.kind, "drawn_as": self.drawn_as, "only": self.only,
            "variant": asdict(self.variant),
            "effects": [self.variant.told(h.as_dict(self.nominal)) for h in self.hidden],
            "asked": list(self.asked), "skipped": self.skipped,
            "foretellable": all(h.draft.predictable for h in self.hidden),
            "noise_floor": (self.variant.strength * self.floor[self.variant.moving]).tolist(),
            "rate": self.instruments.rate, "jitter": self.instruments.jitter,
            "segments": list(self.segments),
        }  # fmt: skip

    def is_of(self, truth: dict) -> bool:
        """Say whether a case written earlier has the same arm: the code may have changed."""
        floor = self.variant.strength * self.floor[self.variant.moving]
        said = [floor, *([h.amplitude] for h in self.hidden)]
        written = [truth["noise_floor"], *([e["amplitude"]] for e in truth["effects"])]
        same = [e["effect"] for e in truth["effects"]] == [h.draft.effect for h in self.hidden]
        return same and all(
            np.allclose(a, b, rtol=1e-9) for a, b in zip(said, written, strict=True)
        )

    def _table(self, recorded: Recorded) -> pa.Table:
        recorded = self.variant.recorded(recorded)
        quantities = {"position": recorded.position, "torque": recorded.torque}
        if self.instruments.velocity:
            quantities["velocity"] = recorded.velocity
        if self.temperature:
            quantities["temperature"] = 25 + 15 * recorded.heat  # [°C]
        columns = {"time": recorded.time}
        for name, values in quantities.items():
            columns |= {f"{name}_{j + 1}": values[:, j] for j in range(values.shape[1])}
        return pa.table(columns)


def draw(
    seed: int, kind: str | None = None, variant: Variant = USUAL, only: str | None = None
) -> Case:
    """Draw a case; the same seed and kind give the same case.

    Args:
        seed: Seeds run through effects and sizes in turn: `single` 0 to 74 has each effect at
            each size once.
        kind: One of `KINDS`; drawn when not given.
        variant: Length of the recordings, strength of the arm, and its joints.
        only: The effect of a `single`, one of `KNOWN` or `LATER`; the one whose turn it is when not
            given.

    Raises:
        UnreachableError: After several draws, no plausible amplitude reached the size.
    """
    random = np.random.default_rng([seed, 7001])
    drawn_as, kind = kind, kind or str(random.choice(KINDS, p=_SHARES))
    plan = variant.plan(_plan(random), random)
    bench = _Bench(variant.world(World.draw(random)), random, plan, variant)
    asked, skipped, hidden, world = (), 0, (), bench.world
    if kind != "null":
        asked = _asked(kind, seed, random)
        hidden, world, skipped = bench.hide(kind, seed, asked, only)
    nominal = world.simulation_file(random)
    responses = [
        world.respond(m, k, np.random.default_rng([seed, k])) for k, m in enumerate(bench.motions)
    ]
    return Case(
        seed=seed, kind=kind, drawn_as=drawn_as, only=only, nominal=nominal,
        recordings=tuple(
            bench.instruments.record(r, world.sensing, k) for k, r in enumerate(responses)
        ),
        hidden=hidden, floor=bench.floor, instruments=bench.instruments,
        segments=tuple(bench.segments), asked=asked, skipped=skipped,
        world=world, variant=variant,
        temperature=bool(random.random() < (0.5 if _thermal(hidden) else 0.1)),
    )  # fmt: skip


def _asked(kind: str, seed: int, random: np.random.Generator) -> tuple[float, ...]:
    if kind == "single":
        return (SIZES[seed // len(KNOWN) % 3],)
    count = int(random.integers(2, 4)) if kind == "set" else 1
    return tuple(float(x) for x in random.choice(SIZES[1:], count))


def _thermal(hidden: tuple[Hidden, ...]) -> bool:
    return any(h.draft.effect == "temperature_dependent_friction" for h in hidden)


class _Bench:
    """Motions, instruments and the plain world of one case, in which effects are sized."""

    def __init__(
        self,
        world: World,
        random: np.random.Generator,
        plan: list[tuple[list[str], float]],
        variant: Variant = USUAL,
    ) -> None:
        self.world, self.random, self.variant = world, random, variant
        self.instruments = Instruments.draw(random)
        _, limits = arm_.load()
        drawn = [variant.motion(kinds, seconds, limits, random) for kinds, seconds in plan]
        self.motions, self.segments = [m for m, _ in drawn], [s for _, s in drawn]
        responses = self.respond(world)
        self.floor = self._floor(world, responses)
        self.yardstick = size.Yardstick.of(world, responses, self.motions[:2], self.floor)

    def hide(
        self, kind: str, seed: int, asked: tuple[float, ...], only: str | None = None
    ) -> tuple[tuple[Hidden, ...], World, int]:
        """Draw effects of the sizes asked for, and put them into the world together."""
        hidden, world, skipped = [], self.world, 0
        for target in asked:
            for _ in range(_TRIES):
                draft = self._draft(kind, seed, hidden, only)
                found = self._scale(draft, target)
                if found is not None:
                    break
                skipped += 1
            else:
                raise UnreachableError(f"seed {seed}: {draft.effect} cannot be {target:g} x floor")
            hidden.append(found)
            world = draft.change(world, found.amplitude)
        return tuple(hidden), world, skipped

    def _draft(self, kind: str, seed: int, before: list[Hidden], only: str | None) -> Draft:
        catalogue = {"unknown": UNKNOWN, "wrong_parameter": WRONG}.get(kind, KNOWN)
        if only is not None:
            catalogue = {only: (KNOWN | LATER)[only]}
        names = [name for name in catalogue if self.variant.allows(name)]
        if kind == "set":
            taken = {h.draft.effect for h in before}
            groups = [group for group in _ALONE if taken & group]
            names = [n for n in names if n not in taken and not any(n in g for g in groups)]
            name = str(self.random.choice(names))
        else:
            name = names[seed % len(names)]
        moving = self.variant.moving
        j = moving[int(self.random.integers(len(moving)))]
        if before and self.random.random() < 0.4:
            j = before[-1].draft.joints[0] - 1
        return catalogue[name](Place(self.random, j, float(self.floor[j]), self.world))

    def _scale(self, draft: Draft, target: float) -> Hidden | None:
        """Search the amplitude at which the effect has the size; None where it is implausible."""
        if draft.guess == draft.largest:  # a fixed change
            sizes = self.sizes(draft, 1.0)
            return Hidden(draft, 1.0, sizes) if sizes.max() >= SIZES[1] else None
        wanted, amplitude = target / draft.scale, draft.guess
        for _ in range(6):
            if amplitude > draft.largest:
                return None
            changed = draft.change(self.world, amplitude)
            change = size.change(changed, self.respond(changed))
            sizes = self.yardstick.sizes(change, changed)
            if abs(sizes.max() / wanted - 1) < _CLOSE:
                return Hidden(draft, amplitude, sizes * draft.scale)
            amplitude *= self._stretch(change, changed, wanted)
        return None

    def _stretch(self, change: np.ndarray, world: World, wanted: float) -> float:
        """Return by what to multiply a torque change so that its size is the one wanted."""
        low, high = 0.02, 50.0  # the torque is nearly linear in the amplitude, the size is not
        for _ in range(10):
            middle = np.sqrt(low * high)
            enough = self.yardstick.sizes(middle * change, world).max() > wanted
            low, high = (low, middle) if enough else (middle, high)
        return float(np.sqrt(low * high))

    def sizes(self, draft: Draft, amplitude: float) -> np.ndarray:
        changed = draft.change(self.world, amplitude)
        return self.yardstick.sizes(size.change(changed, self.respond(changed)), changed)

    def respond(self, world: World) -> list:
        return [
            world.respond(m, k, np.random.default_rng([11, k]))
            for k, m in enumerate(self.motions[:2])
        ]

    def _floor(self, world: World, responses: list) -> np.ndarray:
        floors = []
        for k, response in enumerate(responses):
            recorded = self.instruments.record(response, world.sensing, k)
            moving = np.abs(recorded.velocity) > size.MOVING
            noise = recorded.torque - recorded.clean
            floors.append(size.noise_floor(recorded.time, noise, moving, self.instruments.rate))
        return np.sqrt(np.mean(np.square(floors), axis=0))


def _plan(random: np.random.Generator) -> list[tuple[list[str], float]]:
    """Return the segments and the length of each recording [s]."""
    first = ["limopa", *random.permutation(["creep", "nested"])]
    second = list(random.permutation(["fourier", "points", "creep", "hold"]))
    third = list(random.permutation(["points", "nested", "hold"]))
    fourth = list(random.permutation(["fourier", "creep"]))
    lengths = random.uniform(60, 85, 2), (40.0, 40.0)
    return [
        (first, float(lengths[0][0])), (second, float(lengths[0][1])), (third, 40.0), (fourth, 40.0)
    ]  # fmt: skip
