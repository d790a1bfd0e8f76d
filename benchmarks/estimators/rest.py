"""Errors of a correct simulation on its own arm, at rest and in motion, over the torque's noise.

An iiwa 14 with Coulomb and viscous friction performs a planned motion in MuJoCo, with
several seconds at rest before and behind it. The simulation that predicts is the one that drove it,
so what differs is what the sensors add: noise of the torque, steps and noise of the encoder.
Errors are RMS over the noise of the torque behind the same filter, of all joints.

- `predict`: what `limo predict` says, compared behind the filter.
- `sharp filter`: the same with one bandwidth at rest and in motion, four times that of the torque.
- `exact velocity`: the same with the velocity of positions without error.
- `exact motion`: and with their acceleration; what is left is noise of the torque, and half a cycle
  of the simulated arm, after which its integrator takes friction. So the arm's cycle is short: at
  1 ms, a correct simulation with the exact motion errs 1.4 times the noise.
- `live`: what a stream says 0.1 s late, and its torque behind the stream's own filter.
- `live, one filter`: the same with motion behind the filter of the torque, as a stream of a learned
  model has it; that was the live estimate of a bare simulation, too.

Rows are split by the true speed: at rest, moving, and between, which is to start, stop or reverse.
Beside live estimates stands how large external torque becomes on an arm that nothing touches, and
that has rested for `AGO`: the least threshold at which a stream raises no false alarm at rest, and
so the least push that it can tell there [N m], of the arm's joints the worst.

    python benchmarks/estimators/rest.py [--seed 0]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import minimum_filter1d

import limo_driver as limo
from backends.mujoco_sim.robot import MujocoRobot
from estimators.residual_model import SimulationOnly
from estimators.stream import Stream
from limo_driver.physics import CoulombFriction, Sensors, Simulation, ViscousFriction
from limo_driver.recordings.filters.causal_differentiation import CausalDifferentiator
from limo_driver.recordings.filters.differentiation import SAFE_BANDWIDTH
from limo_driver.recordings.filters.filtered_samples import LIVELIER, SHARPER
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

PERIOD = 1e-3  # [s], of the sensors
CYCLES = 4  # of the simulated arm, each
BEFORE, AFTER = 4.0, 6.0  # [s] at rest
DELAY = 0.1  # [s] of the stream
COULOMB = (2.2, 2.4, 1.6, 1.7, 0.9, 0.45, 0.35)  # [N m]
VISCOUS = (4.0, 4.2, 2.4, 2.6, 1.2, 0.7, 0.6)  # [N m s/rad]
TORQUE_NOISE = (0.05, 0.05, 0.04, 0.04, 0.03, 0.02, 0.02)  # [N m]
ENCODERS = ((1e-5, 0.0), (1e-5, 3e-6), (0.0, 1e-5))  # [rad] step, and noise before it
RATES = (1000, 250)  # [Hz] of the recording
BANDWIDTHS = (10.0, 20.0)  # [Hz]
STILL, MOVING = 1e-4, 1e-2  # [rad/s]
AGO = 0.3  # [s] of rest before and behind
BAR = 1.15


@dataclass(frozen=True)
class Run:
    """An arm's whole run every `PERIOD`: what it did, and what its torque sensor said."""

    simulation: Simulation
    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad], without error
    torque: FloatArray  # (T, n) [N m], measured
    noise: FloatArray  # (T, n) [N m], what of it is noise

    @classmethod
    def of(cls, seed: int) -> Run:
        """Plan a motion and let the arm perform it."""
        simulation = Simulation(
            "iiwa14",
            (
                *(CoulombFriction(joint=j, tau_c=c) for j, c in enumerate(COULOMB, start=1)),
                *(ViscousFriction(joint=j, f_v=v) for j, v in enumerate(VISCOUS, start=1)),
            ),
            sensors=Sensors(torque_noise=TORQUE_NOISE),
        )
        plan = limo.plan("iiwa14", limo.PlanRequest(scaffolds=3), seed=seed)
        cycle = PERIOD / CYCLES
        path = plan.trajectory.resample(cycle).position
        rests = (round(BEFORE / cycle), round(AFTER / cycle))
        with MujocoRobot(simulation, initial_position=path[0], seed=seed, period=cycle) as robot:
            robot.receive()
            run = robot.run(np.pad(path, (rests, (0, 0)), mode="edge"))
        rows, torque = slice(None, None, CYCLES), run.torque
        noise = torque - run.true_torque
        position = run.true_motion.position
        return cls(simulation, run.time[rows], position[rows], torque[rows], noise[rows])

    @property
    def velocity(self) -> FloatArray:
        """Velocity of the positions without error, (T, n) [rad/s]."""
        return np.gradient(self.position, PERIOD, axis=0)

    @property
    def acceleration(self) -> FloatArray:
        """Its derivative, (T, n) [rad/s²]."""
        return np.gradient(self.velocity, PERIOD, axis=0)

    def recorded(self, rate: int, step: float, noise: float, seed: int) -> Recorded:
        """Return what a log at `rate` [Hz] has of it, with an encoder's step and noise [rad]."""
        drawn = noise * np.random.default_rng(seed).standard_normal(self.position.shape)
        position = Sensors(encoder_resolution=(step,)).measure_position(self.position + drawn)
        rows = slice(None, None, round(1 / (PERIOD * rate)))
        return Recorded(
            self.simulation,
            Recording.from_arrays(self.time[rows], position[rows], self.torque[rows]),
            self.noise[rows],
            self.velocity[rows],
            self.acceleration[rows],
        )


@dataclass(frozen=True)
class Recorded:
    """A recording and what is true of it."""

    simulation: Simulation
    recording: Recording
    noise: FloatArray  # (T, n) [N m], of its torque
    velocity: FloatArray  # (T, n) [rad/s], without error
    acceleration: FloatArray  # (T, n) [rad/s²], likewise

    def errors(self, bandwidth: float) -> tuple[dict[str, FloatArray], FloatArray]:
        """Return the errors of each way to predict, (T, n) each, over the noise, and that (n,).

        They are NaN at edges.
        """
        recording, simulation = self.recording, self.simulation
        filtered = recording.filtered_torque(bandwidth)
        inside = ~recording.edges(bandwidth)
        noise = recording.filtered(self.noise, bandwidth)[inside]
        floor = np.sqrt(np.mean(noise**2, axis=0))
        sharp = recording.calm_motion(bandwidth)
        result = {"predict": simulation.predict(recording, bandwidth)}
        top = min(SHARPER * bandwidth, SAFE_BANDWIDTH * recording.rate)
        fixed, lively = recording.motion(top), recording.motion(LIVELIER * bandwidth)
        ways = {
            "sharp filter": replace(fixed, acceleration=lively.acceleration),
            "exact velocity": replace(sharp, velocity=self.velocity),
            "exact motion": replace(sharp, velocity=self.velocity, acceleration=self.acceleration),
        }
        for way, known in ways.items():
            result[way] = simulation.predict_stretches(known, recording.segments, bandwidth)
        result = {k: recording.filtered(v, bandwidth) - filtered for k, v in result.items()}
        stream = Stream(SimulationOnly(simulation, bandwidth), recording.rate, DELAY)
        result["live"] = self._live(stream)
        stream.smoother = None
        stream.differentiator = CausalDifferentiator(recording.rate, bandwidth, DELAY)
        result["live, one filter"] = self._live(stream)
        return {k: np.where(inside[:, None], v / floor, np.nan) for k, v in result.items()}, floor

    def _live(self, stream: Stream) -> FloatArray:
        """Return what a stream errs at each instant, (T, n) [N m]; NaN where it says nothing."""
        recording = self.recording
        said, _ = stream.advance(
            stream.init(), recording.time, recording.position, recording.torque
        )
        assert said.measured is not None  # torque was given
        late, error = stream.samples, np.full(recording.torque.shape, np.nan)
        error[:-late] = (said.torque - said.measured)[late:]
        return error

    @property
    def rested(self) -> NDArray[np.bool_]:
        """Rows at which a joint has rested for long enough, and will, (T, n)."""
        still = np.abs(self.velocity) < STILL
        length = 2 * round(AGO * self.recording.rate) + 1
        return minimum_filter1d(still.astype(np.int8), length, axis=0, mode="constant") > 0

    def rows(self) -> dict[str, NDArray[np.bool_]]:
        """Return the rows of each kind, (T, n)."""
        speed = np.abs(self.velocity)
        return {
            "all": np.ones(speed.shape, dtype=bool),
            "rest": speed < STILL,
            "between": (speed >= STILL) & (speed < MOVING),
            "moving": speed >= MOVING,
        }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--seed", type=int, default=0)
    seed = parser.parse_args().seed
    run = Run.of(seed)
    print("RMS error of a correct simulation over the noise of the torque")
    print(f"bar: at most {BAR} over all rows, by `predict` and `live`\n")
    for rate in RATES:
        for step, noise in ENCODERS:
            case = run.recorded(rate, step, noise, seed)
            rows = case.rows()
            for bandwidth in BANDWIDTHS:
                print(f"{rate} Hz, encoder step {step:g} and noise {noise:g} rad, {bandwidth:g} Hz")
                errors, floor = case.errors(bandwidth)
                for way, error in errors.items():
                    parts = [
                        f"{kind} {np.sqrt(np.nanmean(error[here] ** 2)):5.2f}"
                        for kind, here in rows.items()
                    ]
                    if way.startswith("live"):
                        highest = np.nanmax(np.where(case.rested, np.abs(error), 0.0), axis=0)
                        parts.append(f"push {np.max(highest * floor):.3f} N m")
                    print(f"    {way:17}", "   ".join(parts))


if __name__ == "__main__":
    main()
