"""Time and memory of identifying an iiwa 14 from 804 205 samples, as many as the paper recorded.

The motion is a sum of sinusoids, the torque that of a simulation with friction, plus noise. limo
filters every sample to 10 Hz and sums the regressor of those at 80 Hz or more, since the rest hold
nothing new; the loop over pinocchio's regressor is reckoned over every sample.

    python benchmarks/estimators/identify.py [--samples 804205]
"""

from __future__ import annotations

import argparse
import os
import resource
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pinocchio as pin

from estimators.rigid_body import JointTerms, Rows, identify
from estimators.rigid_body.fitting.normal_equations import CHUNK
from estimators.rigid_body.regressor import PER_LINK, RegressorChain
from limo_driver.model import RobotModel
from limo_driver.physics import CoulombFriction, Simulation, ViscousFriction
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

RATE = 250.0  # [Hz]
NOISE = 0.05  # [N m]
PINOCCHIO_SAMPLES = 20_000
BAR_TIME, BAR_MEMORY = 10.0, 1.0  # [s], [GB]


def make_recording(samples: int) -> Recording:
    """Simulate a motion through the joints' ranges."""
    effects = [CoulombFriction(joint=j, tau_c=1.0 + 0.3 * j) for j in range(1, 8)]
    damping = [ViscousFriction(joint=j, f_v=5.0 - 0.5 * j) for j in range(1, 8)]
    simulation = Simulation("iiwa14", (*effects, *damping))
    random = np.random.default_rng(1)
    t = np.arange(samples) / RATE
    w = 2 * np.pi * random.uniform(0.02, 0.5, (4, 7))
    phase = random.uniform(0, 2 * np.pi, (4, 7))
    amplitude = 0.8 * simulation.model.limits.position_max / 4
    position, velocity, acceleration = (np.zeros((samples, 7)) for _ in range(3))
    for k in range(4):
        angle = t[:, None] * w[k] + phase[k]
        position += amplitude * np.sin(angle)
        velocity += amplitude * w[k] * np.cos(angle)
        acceleration -= amplitude * w[k] ** 2 * np.sin(angle)
    torque = simulation.predict(Motion(t, position, velocity, acceleration))
    torque += NOISE * random.standard_normal(torque.shape)
    return Recording(t, position, torque)


def time_of_pinocchio(model: RobotModel, recording: Recording) -> float:
    """Return the time [s] a loop over all samples of the recording would take."""
    motion = recording[: PINOCCHIO_SAMPLES + 100].motion(10.0)[:PINOCCHIO_SAMPLES]
    data = model.pin_model.createData()
    start = time.perf_counter()
    for q, dq, ddq in zip(motion.position, motion.velocity, motion.acceleration, strict=True):
        pin.computeJointTorqueRegressor(model.pin_model, data, q, dq, ddq)
    return (time.perf_counter() - start) * len(recording) / len(motion)


def time_of_regressor(model: RobotModel, recording: Recording) -> float:
    """Return the time [s] of limo's regressor over all samples, written chunk by chunk."""
    motion = recording[: PINOCCHIO_SAMPLES + 100].motion(10.0)[:PINOCCHIO_SAMPLES]
    chain = RegressorChain.of(model)
    Y = np.zeros((model.n, CHUNK, PER_LINK * model.n))
    start = time.perf_counter()
    for first in range(0, len(motion), CHUNK):
        chain.fill(motion[first : first + CHUNK], Y)
    return (time.perf_counter() - start) * len(recording) / len(motion)


def main() -> None:
    """Print each figure beside its bar."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=804_205)
    samples = parser.parse_args().samples
    model = RobotModel.load("iiwa14")
    recording = make_recording(samples)
    identify(model, [recording[:5000]])  # compiles, or reads the compiled kernels from the cache
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{samples} samples x {recording.n} joints at {RATE:g} Hz; {held:.2f} GB before the fit")
    for name, terms in (
        ("as in the paper", JointTerms((0.01,), offset=False, armature=False)),
        ("all terms, six sign widths", JointTerms()),
    ):
        start, spent = time.perf_counter(), time.process_time()
        found = identify(model, [recording], terms, Rows(bandwidth=10.0))
        seconds, spent = time.perf_counter() - start, time.process_time() - spent
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(f"\n{name}: {found.base.rank} base parameters, condition {found.fit.condition:.3g}")
        print(f"  time         {seconds:6.2f} s    bar {BAR_TIME:g} s")
        print(f"  processor    {spent:6.2f} s")
        print(f"  peak memory  {peak:6.2f} GB   bar {BAR_MEMORY:g} GB, of the whole process")
        print(f"  RMSE         {found.fit.rmse.min():.4f} to {found.fit.rmse.max():.4f} N m")
        regressor = time_of_regressor(model, recording)
        loop = time_of_pinocchio(model, recording)
        print(
            f"  the regressor alone {regressor:.2f} s, pinocchio.computeJointTorqueRegressor in a "
            f"loop {loop:.2f} s: {loop / regressor:.1f} times\n  (each from {PINOCCHIO_SAMPLES} "
            f"samples); the whole identification takes {seconds / loop:.2f} of that loop"
        )


if __name__ == "__main__":
    main()
