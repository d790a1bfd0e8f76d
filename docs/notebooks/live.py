# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Estimate torque live, in a notebook
# `Stream` takes positions and torques as they come, and answers each with the torque that the
# motion needs. What is measured beyond that, something outside exerts: here, somebody who leans on
# the arm for a second and a half. On a network, `limo serve` does the same for any number of arms.

# %%
from time import perf_counter

import matplotlib.pyplot as plt
import numpy as np

import limo_driver as limo
from estimators.stream import Stream
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, ViscousFriction

MAXWELL = {"law": "maxwell_slip", "stiffness": (300.0, 90.0, 25.0), "width": (0.002, 0.006, 0.02)}
arm = limo.Simulation(
    "iiwa14",
    effects=(
        *(CoulombFriction(joint=j, tau_c=0.5) for j in range(1, 8)),
        *(ViscousFriction(joint=j, f_v=1.0) for j in range(1, 8)),
        *(PreslidingHysteresis(joint=j, **MAXWELL) for j in range(1, 8)),
    ),
)


def record(seconds, seed):
    """Return a recording of slow motion with many reversals, and sensor noise."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 0.01)
    slow, fast = (np.outer(time, np.linspace(*of, 7)) for of in ((0.2, 0.5), (0.9, 2.0)))
    slow, fast = slow + random.uniform(0, 6, 7), fast + random.uniform(0, 6, 7)
    position = 0.5 * np.sin(slow) + 0.08 * np.sin(fast)
    torque = arm.predict(limo.Motion.from_positions(time, position))
    torque += 0.02 * random.standard_normal(torque.shape)
    return limo.Recording.from_arrays(time, position, torque)


model = limo.train(limo.identify("iiwa14", record(60.0, seed=1)).simulation, record(60.0, seed=1))

# %% [markdown]
# Ten seconds of other motion, with a push of 15 N at the flange from 5 to 6.5 s:

# %%
lived = record(10.0, seed=3)
torque = lived.torque.copy()
pushed = (lived.time > 5.0) & (lived.time < 6.5)
for row in np.flatnonzero(pushed):
    jacobian = arm.model.flange_jacobian(lived.position[row])
    torque[row] += -jacobian[:3].T @ np.array([0.0, 15.0, 0.0])

stream = Stream(model, rate=100.0, delay=0.1)
state, answers, took = stream.init(), [], []
for time, position, measured in zip(lived.time, lived.position, torque, strict=True):
    begin = perf_counter()
    answer, state = stream.step(state, time, position, measured)
    took.append(perf_counter() - begin)
    answers.append(answer)
print(f"one step: {1e6 * np.median(took):.0f} µs (p50), {stream.delay:g} s late by intent")

# %% [markdown]
# Measured less estimated torque of each joint. The band is the 95 % interval of joint 2.

# %%
when = np.array([answer.time for answer in answers])
outside = np.array([answer.measured - answer.torque for answer in answers])
margin = 1.96 * np.array([answer.std[1] for answer in answers])
figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
axes.fill_between(when, -margin, margin, color="0.85", label="95 % of joint 2")
for j, column in enumerate(outside.T):
    axes.plot(when, column, lw=1, label=f"joint {j + 1}")
axes.set(xlabel="time [s]", ylabel="external torque [N m]", xlim=(1.0, 9.9))
_ = axes.legend(ncols=4, fontsize=8)

# %%
calm = (when > 1.0) & ~((when > 4.8) & (when < 6.7))
print("RMS without push [N m]:", np.sqrt(np.mean(outside[calm] ** 2, axis=0)).round(3))
print("largest under it [N m]:", np.abs(outside[(when > 5) & (when < 6.5)]).max(axis=0).round(2))
