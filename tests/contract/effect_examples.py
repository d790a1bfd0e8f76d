"""Every effect of the catalogue, at least once, with values that show on a small arm."""

from limo_driver.physics import CATALOGUE, Effect, JointEffect

LAWS = {
    "maxwell_slip": {"stiffness": (900.0, 120.0, 30.0), "width": (5e-4, 4e-3, 0.02)},
    "lugre": {"sigma_0": 2e3, "sigma_1": 5.0, "tau_c": 1.0, "tau_s": 0.3, "v_s": 0.02},
    "dahl": {"sigma_0": 2e3, "tau_c": 1.0, "exponent": 1.5},
    "bouc_wen": {"sigma_0": 2e3, "tau_c": 1.0, "beta_ratio": 0.6, "exponent": 1.3},
    "preisach": {"up": (0.21, 0.22), "down": (0.19, 0.20), "weight": (0.4, 0.2)},
}
EXAMPLES = {
    "armature": [{"inertia": 0.4}],
    "asymmetric_friction": [{"tau_plus": 1.2, "tau_minus": 0.7}],
    "backlash": [
        {"gap": 5e-3},
        {"gap": 5e-3, "damping": 20.0},
        {"gap": 5e-3, "drag": 0.8, "v_eps": 0.004},
        {"gap": 5e-3, "drag": 0.8, "width": 2e-3, "v_eps": 0.004},
    ],
    "coulomb_friction": [{"tau_c": 2.2, "v_eps": 0.002}],
    "encoder_offset": [{"offset": 0.01}],
    "external_contact": [
        {
            "windows": ((0.2, 0.5), (0.4, 0.9)),
            "wrench": ((5, 0, -3, 0.1, 0, 0.2), (0, 4, 0, 0, 0, 0)),
        }
    ],
    "gravity_direction": [{"gravity": (0.5, 0.0, -9.7)}],
    "joint_coupling": [{"other": 3, "f_v": 2.0, "tau_c": 0.5, "inertia": 0.1, "ratio": -1}],
    "joint_elasticity": [
        {"stiffness": 1e4, "cubic": 1e-9},
        {"stiffness": 3e3, "damping": 2.0},
        {"stiffness": 3e3, "cubic": -2e-8, "damping": 900.0},
    ],
    "load_dependent_friction": [
        {"coefficient": 0.05},
        {"coefficient": 0.05, "variant": "positive"},
        {"coefficient": 0.05, "variant": "negative"},
        {"coefficient": 0.05, "variant": "stribeck", "v_s": 0.05},
        {"coefficient": 0.002, "variant": "quadratic"},
    ],
    "payload": [{"mass": 2.0, "com": (0.0, 0.02, 0.1), "inertia": (0.01, 0, 0, 0.01, 0, 0.005)}],
    "picked_up_load": [{"start": 0.4, "mass": 2.0, "com": (0.0, 0.02, 0.1)}],
    "position_dependent_friction": [{"positions": (0.1, 0.2, 0.3), "excess": (0.5, -0.2, 1.0)}],
    "presliding_hysteresis": [{"law": law, **values} for law, values in LAWS.items()],
    "quadratic_drag": [{"coefficient": 3.0}],
    "spring_load": [{"stiffness": 20.0, "rest": 0.3, "cubic": 5.0}],
    "stribeck_friction": [{"tau_s": 0.8, "v_s": 0.02, "delta": 1.5}],
    "temperature_dependent_friction": [
        {"excess": 1.5, "time_constant": 2.0},
        {"per_kelvin": -0.1, "reference": 30.0},
    ],
    "time_delay": [{"delay": 0.0137}, {"lag": 0.02}, {"delay": 0.003, "lag": 0.01}],
    "torque_crosstalk": [{"source": 4, "gain": 0.03}],
    "torque_drift": [{"times": (0.0, 0.5, 2.0), "offset": (0.0, 0.4, -0.2)}],
    "torque_gain": [{"gain": 0.05}],
    "torque_offset": [{"offset": -0.3}],
    "torque_ripple": [{"cycles_per_rev": (320, 640), "amplitude": (0.3, 0.1), "phase": (0.2, 1)}],
    "viscous_friction": [{"f_v": 4.0}, {"f_v_plus": 4.0, "f_v_minus": 3.0}],
}
JOINT = 2


def make(name: str, **values: object) -> Effect:
    owner = CATALOGUE[name]
    joint = {"joint": JOINT} if issubclass(owner, JointEffect) or name == "joint_coupling" else {}
    return owner(**joint, **values)
