"""Turn the effects of a simulation into tables for compiled code, or run them sample by sample.

Each effect asks in its `realise`. One that is sampled runs through its `advance`, cycle by cycle in
Python: slower, and as correct. What changes the rigid body is in `Simulation.body` already, of
which the MuJoCo model is made.

The drives of the simulated arm: position servo, impedance and torque control, saturation.

The damping of a controller is left to the integrator, which takes it implicitly: it is stable
however strong. All functions are called from compiled code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from backends.mujoco_sim import layout as row
from backends.virtual import check_gains
from limo_driver.errors import ConfigError
from limo_driver.physics import BodyEffect, Effect, JointCoupling, SensorEffect, TorqueEffect
from limo_driver.physics.effects.laws import ROW, friction_torque
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Iterable

    from backends.mujoco_sim.layout import Arrays, Scratch, Servo
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray, ImpedanceCommand, IntArray

# A spring on an inertia is stable while h sqrt(k / M) < 2; at half of that it is still followed.
LARGEST_STEP_RATIO = 1.0
LARGEST_DAMPING_RATIO = 100.0  # h d / M; implicit, so stable, but no drive damps faster
LARGEST_COUPLING_RATIO = 0.5  # inertia that acts one cycle late over inertia; diverges at 1
LARGEST_WIND_UP_RATIO = 0.5  # presliding stiffness over joint stiffness
_POSES = 50


class Plant(NamedTuple):
    """Joint physics of n joints as tables, for compiled code; F frictions, E spring elements."""

    motor_inertia: FloatArray  # (n,) [kg m²], behind the torque sensor
    armature: FloatArray  # (n,) [kg m²], all reflected inertia: the motor's and that of effects
    compliance: FloatArray  # (n,) [rad/(N m)]
    cubic: FloatArray  # (n,) [rad/(N m)³]
    offset: FloatArray  # (n,) [N m], of the torque sensor
    friction_joint: IntArray  # (F,) 0-based
    friction_law: IntArray  # (F,) see friction_laws
    friction_parameters: FloatArray  # (F, laws.ROW)
    element_joint: IntArray  # (E,) 0-based
    element_stiffness: FloatArray  # (E,) [N m/rad]
    element_width: FloatArray  # (E,) [rad]


@dataclass
class Draft:
    """Collects what the effects of a simulation ask for, see `SimulatedRobot`."""

    n: int
    frictions: list[tuple[int, int, FloatArray]] = field(default_factory=list)  # joint, law, row
    elements: list[tuple[int, float, float]] = field(default_factory=list)
    sampled: list[Effect] = field(default_factory=list)  # effects without a native form
    sensed: list[SensorEffect | TorqueEffect] = field(default_factory=list)  # change no motion
    loads: list[tuple[float, BodyEffect]] = field(default_factory=list)  # [s], from when each is

    def __post_init__(self) -> None:
        self.link_inertia, self.compliance, self.cubic, self.offset = np.zeros((4, self.n))
        self.encoder_offset = np.zeros(self.n)  # [rad]
        # What sampled effects make stiff or heavy, one cycle late: the step has to carry it.
        self.late_stiffness, self.late_damping, self.late_inertia = np.zeros((3, self.n))

    def sample(self, effect: Effect) -> None:
        """Run an effect one sample in each cycle."""
        self.sampled.append(effect)

    def sense(self, effect: SensorEffect | TorqueEffect) -> None:
        """Run an effect on what the torque sensor says."""
        self.sensed.append(effect)

    def carry(self, start: float, load: BodyEffect) -> None:
        """Change the rigid body from a time on [s]."""
        self.loads.append((start, load))

    def add_friction(self, joint: int, law: int, parameters: FloatArray) -> None:
        """Add a friction of one of `effects/laws.py`."""
        self.frictions.append((joint - 1, law, parameters))

    def add_slipping_spring(self, joint: int, stiffness: float, width: float) -> None:
        """Add a spring [N m/rad] that slips at a width [rad]."""
        self.elements.append((joint - 1, stiffness, width))

    def add_inertia(self, joint: int, inertia: float) -> None:
        """Add reflected inertia [kg m²]."""
        self.link_inertia[joint - 1] += inertia

    def add_compliance(self, joint: int, linear: float, cubic: float) -> None:
        """Add compliance between encoder and link [rad/(N m)], [rad/(N m)³]."""
        self.compliance[joint - 1] += linear
        self.cubic[joint - 1] += cubic

    def add_torque_offset(self, joint: int, offset: float) -> None:
        """Add an offset to the torque sensor [N m]."""
        self.offset[joint - 1] += offset

    def add_encoder_offset(self, joint: int, offset: float) -> None:
        """Move the zero of the encoder [rad]."""
        self.encoder_offset[joint - 1] += offset

    def expect_late(
        self, joint: int, *, stiffness: float = 0.0, damping: float = 0.0, inertia: float = 0.0
    ) -> None:
        """Note what a sampled effect makes stiff, damped or heavy, one cycle late."""
        self.late_stiffness[joint - 1] += stiffness
        self.late_damping[joint - 1] += damping
        self.late_inertia[joint - 1] += inertia

    @property
    def shafts(self) -> tuple[JointCoupling, ...]:
        """One of each two couplings that are one shaft: equal, with the joints exchanged."""
        couplings = [effect for effect in self.sampled if isinstance(effect, JointCoupling)]
        return tuple(
            one
            for index, one in enumerate(couplings)
            if replace(one, joint=one.other, other=one.joint) in couplings[index + 1 :]
        )

    def plant(self, motor_inertia: FloatArray) -> Plant:
        """Return the tables."""
        frictions = sorted(self.frictions, key=lambda row: row[0])
        elements = sorted(self.elements)
        return Plant(
            motor_inertia=motor_inertia,
            armature=motor_inertia + self.link_inertia,
            compliance=self.compliance,
            cubic=self.cubic,
            offset=self.offset,
            friction_joint=np.array([row[0] for row in frictions], dtype=np.int64),
            friction_law=np.array([row[1] for row in frictions], dtype=np.int64),
            friction_parameters=np.array([row[2] for row in frictions]).reshape(-1, ROW),
            element_joint=np.array([row[0] for row in elements], dtype=np.int64),
            element_stiffness=np.array([row[1] for row in elements], dtype=float),
            element_width=np.array([row[2] for row in elements], dtype=float),
        )


def draft_of(effects: Iterable[Effect], n: int) -> Draft:
    """Realise every effect on an arm of n joints.

    Raises:
        ConfigError: The simulated robot cannot have one of them.
    """
    draft = Draft(n)
    for effect in effects:
        effect.realise(draft)
    return draft


def effective_inertia(model: RobotModel, armature: FloatArray) -> FloatArray:
    """Return the least inertia that a torque on one joint alone moves, over poses, (n,) [kg m²]."""
    return np.min(
        [
            1.0 / np.diag(np.linalg.inv(model.mass_matrix(q) + np.diag(armature)))
            for q in _poses(model)
        ],
        axis=0,
    )


def usual_load(model: RobotModel) -> FloatArray:
    """Return the most torque that each joint holds and accelerates, over poses, (n,) [N m]."""
    poses = _poses(model)
    inertia = np.array([np.diag(model.mass_matrix(q)) for q in poses])
    held = np.abs(model.gravity_torque(poses))
    return np.max(held + inertia * model.limits.acceleration, axis=0)


def _poses(model: RobotModel) -> FloatArray:
    """Return the same poses each time, anywhere within the limits, (_POSES, n) [rad]."""
    random = np.random.default_rng(0)
    limits = model.limits
    return random.uniform(limits.position_min, limits.position_max, (_POSES, model.n))


def check_elements(plant: Plant, inertia: FloatArray, period: float) -> None:
    """Refuse presliding springs that are too stiff for the step or for the gear they act on.

    Raises:
        ConfigError: Names the joint, its stiffness and what the step allows.
    """
    stiffness = np.bincount(
        plant.element_joint, weights=plant.element_stiffness, minlength=inertia.size
    )
    most = largest_stiffness(inertia, period)
    for j in np.flatnonzero(stiffness > most):
        raise ConfigError(
            f"presliding_hysteresis, joint {j + 1}: a stiffness of {stiffness[j]:.4g} N m/rad on "
            f"{inertia[j]:.3g} kg m² needs a shorter period than {period:g} s; at that period at "
            f"most {most[j]:.4g} N m/rad, or a larger motor_inertia"
        )
    for j in np.flatnonzero(stiffness * plant.compliance > LARGEST_WIND_UP_RATIO):
        raise ConfigError(
            f"presliding_hysteresis, joint {j + 1}: its stiffness of {stiffness[j]:.4g} N m/rad "
            f"has to be below half the joint_elasticity of {1 / plant.compliance[j]:.4g} N m/rad"
        )


def check_late(draft: Draft, inertia: FloatArray, period: float) -> None:
    """Refuse sampled effects that are too stiff or too heavy for acting one cycle late.

    Raises:
        ConfigError: Names the effect, the joint and what the step allows.
    """
    stiffness = draft.late_stiffness + draft.late_damping / period
    most = largest_stiffness(inertia, period)
    for j in np.flatnonzero(stiffness > most):
        raise ConfigError(
            f"joint {j + 1}: presliding (sigma_0 + sigma_1 / {period:g} s) and play (drag / width) "
            f"are {stiffness[j]:.4g} N m/rad stiff; on {inertia[j]:.3g} kg m² the step of "
            f"{period:g} s carries at most {most[j]:.4g} N m/rad"
        )
    for j in np.flatnonzero(draft.late_inertia > LARGEST_COUPLING_RATIO * inertia):
        raise ConfigError(
            f"joint_coupling, joint {j + 1}: inertia = {draft.late_inertia[j]:.4g} kg m² has to be "
            f"below half of the {inertia[j]:.3g} kg m² that the joint moves"
        )


def check_impedance(command: ImpedanceCommand, inertia: FloatArray, period: float) -> None:
    """Refuse a stiffness that the step cannot follow, and a damping that no drive has.

    Raises:
        JointLimitError: Names the joint and what is allowed.
    """
    most_damping = inertia * LARGEST_DAMPING_RATIO / period
    check_gains(command, largest_stiffness(inertia, period), most_damping)


def largest_stiffness(inertia: FloatArray, period: float) -> FloatArray:
    """Return the stiffest spring that the step follows on each joint, (n,) [N m/rad]."""
    return inertia * (LARGEST_STEP_RATIO / period) ** 2


_SMALL_VELOCITY = 1e-9  # [rad/s]


@compiled(inline="always")
def servo_torque(
    arrays: Arrays,
    plant: Plant,
    servo: Servo,
    memory: FloatArray,
    added: FloatArray,
    target: FloatArray,
    own: Scratch,
) -> None:
    """Position servo of the drives: feed-forward of the rigid body, and a PID on every joint.

    The target answers a measurement that is one cycle old by now, so it is carried forward by one
    cycle. Gains follow the inertia that a joint moves, for one bandwidth in all poses; the
    damping is left to the integrator, which takes it implicitly.
    """
    h, n = servo.period, target.size
    wanted, ahead, speed = own.wanted, own.ahead, own.speed
    inertial, torque, damping = own.inertial, own.torque, own.damping
    for j in range(n):
        v = (target[j] - memory[row.LAST_TARGET * n + j]) / h
        wanted[j] = (v - memory[row.TARGET_VELOCITY * n + j]) / h
        ahead[j] = target[j] + h * (v + h * wanted[j])
        speed[j] = v + 2.0 * h * wanted[j]
        memory[row.LAST_TARGET * n + j], memory[row.TARGET_VELOCITY * n + j] = target[j], v
    multiply(arrays, n, wanted, inertial)
    for j in range(n):
        mass = arrays.inertia[arrays.row_start[j] + arrays.row_size[j] - 1]
        nominal = inertial[j] - plant.armature[j] * wanted[j] + arrays.bias[j]
        wind_up = (
            deflection(plant.compliance[j], plant.cubic[j], nominal)
            + added[row.ADDED_STATIC_WIND_UP * n + j]
        )
        error = ahead[j] - arrays.position[j] - wind_up
        stiffness = mass * servo.bandwidth**2
        integral = memory[row.INTEGRAL * n + j] + stiffness * servo.integral_rate * h * error
        limit = servo.torque_limit[j]
        memory[row.INTEGRAL * n + j] = min(max(integral, -limit), limit)
        damping[j] = 2.0 * servo.bandwidth * mass
        torque[j] = (
            arrays.bias[j]
            + inertial[j]
            + stiffness * error
            + memory[row.INTEGRAL * n + j]
            + damping[j] * (speed[j] - own.rate[j])
        )


@compiled(inline="always")
def compliant(
    arrays: Arrays,
    memory: FloatArray,
    mode: int,
    target: FloatArray,
    command: FloatArray,
    own: Scratch,
) -> None:
    """Impedance and torque control, on top of the compensated gravity."""
    rate, torque, damping = own.rate, own.torque, own.damping
    n = target.size
    for j in range(n):
        torque[j] = arrays.bias[j] + command[row.FEED_FORWARD * n + j]
        damping[j] = 0.0
        if mode == row.IMPEDANCE:
            encoder = arrays.position[j] + memory[row.STATIC_WIND_UP * n + j]
            damping[j] = command[row.DAMPING * n + j]
            torque[j] += (
                command[row.STIFFNESS * n + j] * (target[j] - encoder) - damping[j] * rate[j]
            )


@compiled(inline="always")
def uncompensated(
    arrays: Arrays,
    memory: FloatArray,
    target: FloatArray,
    command: FloatArray,
    own: Scratch,
) -> None:
    """Give each joint what its own drive makes, where the position servo does not run.

    A drive on a bus knows its motor and not the arm, so nothing is compensated.
    """
    rate, torque, damping = own.rate, own.torque, own.damping
    n = target.size
    for j in range(n):
        if command[row.SERVO * n + j] != 0.0:
            torque[j] += command[row.FEED_FORWARD * n + j]
            continue
        encoder = arrays.position[j] + memory[row.STATIC_WIND_UP * n + j]
        damping[j] = command[row.DAMPING * n + j]
        torque[j] = command[row.FEED_FORWARD * n + j] - damping[j] * rate[j]
        torque[j] += command[row.STIFFNESS * n + j] * (target[j] - encoder)
        memory[row.INTEGRAL * n + j] = 0.0


@compiled(inline="always")
def saturate(servo: Servo, n: int, own: Scratch) -> None:
    """Keep the drives within their torque; a saturated drive does not damp."""
    velocity, torque, damping = own.velocity, own.torque, own.damping
    for j in range(n):
        limit = servo.torque_limit[j]
        if abs(torque[j] - damping[j] * velocity[j]) > limit:
            torque[j] = math.copysign(limit, torque[j] - damping[j] * velocity[j])
            damping[j] = 0.0


@compiled(inline="always")
def deflection(compliance: float, cubic: float, load: float) -> float:
    """Return the wind-up of a gear [rad] under `load` [N m]."""
    return load * (compliance + cubic * load * load)


@compiled(inline="always")
def multiply(arrays: Arrays, n: int, vector: FloatArray, product: FloatArray) -> None:
    """Write M(q) times `vector` into `product`."""
    for i in range(n):
        product[i] = 0.0
        start, size = arrays.row_start[i], arrays.row_size[i]
        for k in range(start, start + size):
            j = arrays.column[k]
            product[i] += arrays.inertia[k] * vector[j]
            if j != i:
                product[j] += arrays.inertia[k] * vector[i]


@compiled(inline="always")
def friction_damping(
    law: int,
    p0: float,
    p1: float,
    p2: float,
    p3: float,
    fastest: float,
    up: float,
    down: float,
    velocity: float,
) -> float:
    """Return the secant torque / velocity [N m s/rad]; its limit at rest.

    An integrator that takes this damping implicitly dissipates at any step size, where the
    friction itself, taken explicitly, would reverse the motion.
    """
    v = away_from_rest(velocity)
    inside = min(max(v, -fastest), fastest)
    torque = friction_torque(law, p0, p1, p2, p3, inside)
    return (torque + (up if v > inside else down) * (v - inside)) / v


@compiled(inline="always")
def away_from_rest(velocity: float) -> float:
    """Return `velocity` [rad/s], of at least a size by which a torque can be divided."""
    return _SMALL_VELOCITY if abs(velocity) < _SMALL_VELOCITY else velocity
