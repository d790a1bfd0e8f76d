# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Learn what a rigid body leaves, in a notebook
# The joints of this arm remember where they last reversed. A rigid body with Coulomb and viscous
# friction, identified from a minute of motion, misses that; what is learned beside it does not.

# %%
import matplotlib.pyplot as plt
import numpy as np

import limo_driver as limo
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


# %%
identified = limo.identify("iiwa14", record(60.0, seed=1))
model = limo.train(identified.simulation, record(60.0, seed=1), "joint-physics")

# %% [markdown]
# Judged on motion that nothing was fitted to:

# %%
found = limo.evaluate(model, record(30.0, seed=2))
found

# %% [markdown]
# Friction over position while a joint reverses: the memory of the joint is what makes it a loop.

# %%
rows, j = slice(500, 1500), 3
own = found.motion.position[rows, j]
figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
for name, torque, style in (
    ("measured", found.measured, {"color": "0.6", "lw": 4}),
    ("rigid body", found.estimate.simulation, {"color": "C1"}),
    (model.name, found.estimate.torque, {"color": "C0"}),
):
    axes.plot(own, (torque - found.frictionless)[rows, j], label=name, **style)
axes.set(xlabel=f"position of joint {j + 1} [rad]", ylabel="friction [N m]")
_ = axes.legend()

# %% [markdown]
# `found.save("evaluation/")` writes the same as a page, `model.save("model/")` what `limo serve`
# takes.

# %%
found.save("evaluation")
model.save("model")
