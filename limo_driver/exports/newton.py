"""Drives in USD as Newton, Isaac Sim 6 and Isaac Lab 3 have them: a `NewtonActuator` of each joint.

It has a law (PD, PID, or a network where the law has a dead band or punch), limits (an effort, and
the line of a DC motor), and a delay in steps of the simulation; angles are radians. It is the whole
drive: a stiffness and damping that `UsdPhysics` has of the joint become 0, as plain Newton would
add both.
"""

# usd-core ships no usable stubs, and is an extra.
# pyright: reportMissingImports=false, reportMissingModuleSource=false, reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.exports.changes.origin import alike
from limo_driver.exports.remainder import BEYOND_ACTUATORS, missing_numbers
from limo_driver.model.descriptions.description import RobotDescription, StatedMotor, StatedServo
from limo_driver.model.descriptions.usd_joints import (
    ACTUATOR,
    DELAY,
    LIMIT,
    MOTOR,
    PD,
    RATE,
    TARGETS,
    actuators_of,
    axis_of,
    rate_of_steps,
    schemas_of,
    targets_of,
    value_of,
)
from limo_driver.physics import JointDrive, PositionServo, Simulation
from limo_driver.physics.drives import DcMotor, as_described
from limo_driver.runtime.outputs import whole

_PID: Final = "NewtonPIDControlAPI"
_NETWORK: Final = "NewtonNeuralControlAPI"
_HELD: Final = {_PID: ("ki",), _NETWORK: ("dead_band", "punch"), PD: ()}  # beyond a servo, by law
_STEPS: Final = "delaySteps"
_SAME: Final = 1e-6  # relative: attributes are floats of 32 bits
_WHOLE: Final = 1e-6  # [s], by which a delay may miss its steps
_RISE: Final = 1e-3  # [rad], over which the punch of a network builds up
_OPSET: Final = 17
_FORMAT: Final = 8  # of ONNX's files


class Actuators(NamedTuple):
    """What was written of drives."""

    files: tuple[Path, ...]  # networks
    unwritten: tuple[str, ...]  # lines: what no actuator has
    dropped: tuple[str, ...]  # lines: drives of `UsdPhysics` that actuators stand for


@dataclass(frozen=True)
class _Drive:
    """A drive, and what the schemas have of it."""

    drive: JointDrive
    known: StatedServo | StatedMotor  # as descriptions have it
    motor: DcMotor | None
    rate: float  # of the simulation's steps [Hz]

    @property
    def law(self) -> str:
        """The schema of its law."""
        if not isinstance(self.drive, PositionServo):
            return PD
        if self.drive.ki > 0:
            return _PID
        return _NETWORK if self.drive.dead_band or self.drive.punch else PD

    @property
    def steps(self) -> int:
        """Of its delay."""
        return round(self.known.delay * self.rate)

    def is_stated(self, stated: StatedServo | StatedMotor | None) -> bool:
        """Say whether a file has it already, and it is nothing more."""
        if self.motor is not None or self.law != PD or type(stated) is not type(self.known):
            return False
        return stated is not None and alike(self._numbers(stated), self._numbers(self.known), _SAME)

    def _numbers(self, own: StatedServo | StatedMotor) -> tuple[float, ...]:
        gains = (own.kp, own.kd) if isinstance(own, StatedServo) else ()
        return (*gains, own.limit or 0.0, round(own.delay * self.rate))

    def schemas(self) -> Mapping[str, Mapping[str, float]]:
        """Return its numbers by the schema that has them."""
        servo = self.known if isinstance(self.known, StatedServo) else StatedServo(0.0, 0.0, None)
        law = {} if self.law == _NETWORK else {"kp": servo.kp, "kd": servo.kd}
        if self.law == _PID and isinstance(self.drive, PositionServo):
            law["ki"] = self.drive.ki
            if self.drive.integral_limit is not None:
                law["integralMax"] = self.drive.integral_limit / self.drive.ki
        found: dict[str, Mapping[str, float]] = {self.law: law}
        limit = self.known.limit
        if self.motor is not None:
            line = {"saturationEffort": self.motor.stall, "velocityLimit": self.motor.free_speed}
            found[MOTOR] = line | ({} if limit is None else {"maxMotorEffort": limit})
        elif limit is not None:
            found[LIMIT] = {"maxEffort": limit}
        return found | ({DELAY: {_STEPS: self.steps}} if self.steps else {})

    def unwritten(self, name: str) -> Iterator[str]:
        """Yield a line for each of its numbers that no schema has."""
        keys = [key for key in (*BEYOND_ACTUATORS, "gain") if key not in _HELD[self.law]]
        yield from missing_numbers(self.drive, name, keys)
        left = self.known.delay - self.steps / self.rate
        if abs(left) > _WHOLE:
            yield (
                f"{left:.3g} s of the delay of {name}: a NewtonActuator has whole steps, of "
                f"{1.0 / self.rate:.3g} s"
            )


def write_actuators(
    stage: Any,  # noqa: ANN401
    joints: Mapping[str, Any],
    simulation: Simulation,
    description: RobotDescription,
    place: Path,
) -> Actuators:
    """Write a `NewtonActuator` of each drive that the file does not have as it is.

    Args:
        stage: Of the layer.
        joints: Prims of joints, by name.
        simulation: With the drives.
        description: Of the file.
        place: Of the layer; networks are written into its folder.

    Raises:
        ConfigError: A network is needed, and `onnx` is not installed; or cannot be written.
    """
    stated_rate, known = rate_of_steps(stage), description.servos | description.motors
    files: list[Path] = []
    unwritten, dropped, late = list[str](), list[str](), False
    for own in _drives(simulation, stated_rate or RATE):
        name = simulation.model.joint_names[own.drive.joint - 1]
        unwritten += own.unwritten(name)
        if own.is_stated(known.get(name)):
            continue
        late |= own.steps > 0
        network = place.with_name(f"{name}_actuator.onnx")
        if own.law == _NETWORK and isinstance(own.drive, PositionServo):
            with whole(network) as draft:
                draft.write_bytes(_network(own.drive))
            files.append(network)
        _write(_prim(stage, joints[name]), own, network.name)
        if _stop_drive(joints[name]):
            dropped.append(f"joint {name}: its UsdPhysics drive, for which the NewtonActuator is")
    if late and stated_rate is None:
        unwritten.append(f"the rate of steps of delays: no scene states one, {RATE:g} Hz is taken")
    return Actuators(tuple(files), tuple(unwritten), tuple(dropped))


def _drives(simulation: Simulation, rate: float) -> Iterator[_Drive]:
    motors = {drive.joint: drive for drive in simulation.drives if isinstance(drive, DcMotor)}
    for drive in simulation.drives:
        if (known := as_described(drive)) is not None:
            yield _Drive(drive, known, motors.get(drive.joint), rate)


def _prim(stage: Any, joint: Any) -> Any:  # noqa: ANN401
    """Return the actuator that moves a joint and nothing else: the file's own, or a new one."""
    path, found = joint.GetPath(), None
    for prim in actuators_of(stage):
        targets = targets_of(prim)
        if path not in targets:
            continue
        if others := [target for target in targets if target != path]:
            prim.GetRelationship(TARGETS).SetTargets(others)
        elif found is None:
            found = prim
        else:
            prim.SetActive(False)
    if found is not None:
        return found
    place = path.GetParentPath().AppendChild(f"{joint.GetName()}_actuator")
    while stage.GetPrimAtPath(place):
        place = place.GetParentPath().AppendChild(f"{place.name}_")
    made = stage.DefinePrim(place, ACTUATOR)
    made.CreateRelationship(TARGETS, False).SetTargets([path])
    return made


def _write(prim: Any, own: _Drive, network: str) -> None:  # noqa: ANN401
    from pxr import Sdf

    schemas, kinds = own.schemas(), Sdf.ValueTypeNames
    if schemas_of(prim) != set(schemas):
        prim.SetMetadata("apiSchemas", Sdf.TokenListOp.CreateExplicit(list(schemas)))
    for values in schemas.values():
        for name, value in values.items():
            kind = kinds.Int if name == _STEPS else kinds.Float
            if value_of(prim, f"newton:{name}", np.nan) != np.float32(value):
                prim.CreateAttribute(f"newton:{name}", kind, False).Set(value)
    if own.law == _NETWORK:
        asset = Sdf.AssetPath(f"./{network}")
        prim.CreateAttribute("newton:modelPath", kinds.Asset, False).Set(asset)


def _stop_drive(joint: Any) -> bool:  # noqa: ANN401
    """Set what `UsdPhysics` drives a joint with to 0; say whether there was anything."""
    drive = f"drive:{axis_of(joint)}:physics"
    names = [f"{drive}:{name}" for name in ("stiffness", "damping")]
    stated = [name for name in names if value_of(joint, name)]
    for name in stated:
        joint.GetAttribute(name).Set(0.0)
    return bool(stated)


def _network(drive: PositionServo) -> bytes:
    """Return a network that is the law of a servo: (e, dq) in, torque out [rad, rad/s, N m].

    kp e' + punch sign(e') - kd dq, with e' the error without the dead band, is a sum of ramps; the
    sign is one over a milliradian.
    """
    try:
        import onnx
    except ImportError:
        raise ConfigError(
            "a dead band or punch is written for Newton as a network, which needs "
            "`pip install onnx`"
        ) from None
    band, slope = drive.dead_band, drive.punch / _RISE
    edges = -np.array([band, band, band + _RISE, band + _RISE, 0.0, 0.0])
    sides = np.array([[1, -1, 1, -1, 0, 0], [0, 0, 0, 0, 1, -1]])
    gains = np.array([drive.kp + slope, -slope, -drive.kd]).repeat(2) * np.tile([1.0, -1.0], 3)
    helper, real = onnx.helper, onnx.TensorProto.FLOAT
    nodes = [
        helper.make_node("Gemm", ["input", "sides", "edges"], ["sum"]),
        helper.make_node("Relu", ["sum"], ["ramps"]),
        helper.make_node("Gemm", ["ramps", "gains", "none"], ["output"]),
    ]
    constants = {"sides": sides, "edges": edges, "gains": gains[:, None], "none": np.zeros(1)}
    graph = helper.make_graph(
        nodes,
        "limo",
        [helper.make_tensor_value_info("input", real, ("samples", 2))],
        [helper.make_tensor_value_info("output", real, ("samples", 1))],
        [onnx.numpy_helper.from_array(x.astype(np.float32), k) for k, x in constants.items()],
    )
    made = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_FORMAT
    )
    helper.set_model_props(
        made, {"model_type": "mlp", "input_order": "pos_vel", "input_idx": "[0]"}
    )
    onnx.checker.check_model(made)
    return made.SerializeToString()
