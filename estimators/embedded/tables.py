"""Tables of numbers as C, and those of the rigid body.

What a model has learned as C: constants, tables and the code that takes them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import singledispatch
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimators.hybrid import HybridModel
from estimators.joint_physics import JointPhysics, prediction
from estimators.joint_physics import columns as terms
from estimators.joint_physics.calibration import FASTER
from estimators.neural import Network
from estimators.neural.lstm import Lstm, LstmFcl
from estimators.neural.mlp import Mlp
from estimators.residual_model import SimulationOnly
from estimators.rigid_body.regressor import RegressorChain, link_parameters, parameters_of
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.physics.effects.body import Payload
from limo_driver.types import FloatArray

SIDE_BY_SIDE: Final = 4  # doubles, of which what stands for each joint is filled up to a multiple
_WIDTH: Final = 98  # of a line
_TYPES: Final = {"f8": "double", "f4": "float", "i8": "int"}
_AXES: Final = "xyz"
_NETWORKS: Final = "mlp7, lstm-2, lstm-fcl, gru or lru"
_NOTHING: Final = "0.0"  # a sum without terms
_ROUNDING: Final = 1e-15  # of a direction cosine, which right angles leave in place of zero
_Term: TypeAlias = tuple[float, str]  # a factor, and of what


def number(value: float) -> str:
    """Return a number that C reads back as the same one."""
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


def table(name: str, values: ArrayLike, aligned: int | None = None) -> str:
    """Return the definition of a constant array of doubles, floats or ints, of any shape.

    Args:
        name: Of the array.
        values: Its entries.
        aligned: To so many bytes, if more than their type needs.
    """
    array = np.asarray(values)
    kind = array.dtype.str[1:]
    sizes = "".join(f"[{size}]" for size in array.shape)
    where = f"_Alignas({aligned}) " if aligned else ""
    return f"static {where}const {_TYPES[kind]} {name}{sizes} = {_entries(array, kind)};\n"


def defines(values: Mapping[str, float | bool]) -> str:
    """Return constants of the preprocessor."""
    return "".join(f"#define {name} {_constant(value)}\n" for name, value in values.items())


def _constant(value: float | bool) -> str:  # a value, not an option
    return str(int(value)) if isinstance(value, (bool, int, np.integer)) else number(value)


def _entries(array: NDArray[Any], kind: str) -> str:
    if array.ndim > 1:
        return "{" + ",\n".join(_entries(row, kind) for row in array) + "}"
    lines, line = list[str](), "{"
    for text in _texts(array, kind):
        if len(line) + len(text) > _WIDTH:
            lines.append(line)
            line = ""
        line += text + ", "
    return "\n".join([*lines, line.removesuffix(", ") + "}"])


def _texts(array: NDArray[Any], kind: str) -> list[str]:
    values = array.tolist()
    if kind != "f4":
        return [str(value) if kind == "i8" else number(value) for value in values]
    texts = [f"{value:.9g}" for value in values]  # tells any two floats apart
    return [text + (".0F" if text.lstrip("-").isdigit() else "F") for text in texts]


def tables(body: RobotModel, payloads: Sequence[Payload]) -> str:
    """Return what the recursion reads of a rigid body and its payloads."""
    links = link_parameters(body)
    found = {"base_acceleration": -RegressorChain.of(body).gravity, "link": links}
    if payloads:
        carried = np.zeros_like(links)
        carried[-1] = np.sum([parameters_of(item.load) for item in payloads], axis=0)
        found["payload"] = carried
    return "".join(table(name, values) for name, values in found.items())


def each_joint(body: RobotModel, code: str) -> str:
    """Return code with its parts for each joint written out.

    What stands between `/*: outward */` and `/*: end */` is repeated for each joint, `@` its
    number from 0; after `/*: inward */` from the last joint to the second. `/*: joints */` gives
    way to those functions of each joint that are called.
    """
    n = body.n
    orders = {"outward": range(n), "inward": range(n - 1, 0, -1)}

    def written_out(found: re.Match[str]) -> str:
        return "".join(found[2].replace("@", str(i)) for i in orders[found[1]])

    code = re.sub(r"/\*: (outward|inward) \*/\n(.*?)/\*: end \*/\n", written_out, code, flags=re.S)
    own = [text for name, text in _functions(body).items() if f"{name}(" in code]
    return code.replace("/*: joints */\n", "".join(own))


def _functions(body: RobotModel) -> dict[str, str]:
    """Return the functions of each joint by name.

    A rotation about an axis u by q is A + B cos q + C sin q with A = u uᵀ, B = 1 - u uᵀ and
    C = [u]×.
    """
    chain, found = RegressorChain.of(body), dict[str, str]()
    axes, places = chain.axis[:, 3:], chain.translation
    for i, (fixed, place, u) in enumerate(zip(chain.rotation, places, axes, strict=True)):
        along, about = np.outer(u, u), np.cross(np.eye(3), u)
        turns = np.array([fixed @ along, fixed @ (np.eye(3) - along), fixed @ about])
        own = _joint(_exact(turns), place, _exact(u))
        found |= {f"{name}_{i}": text.replace("@", str(i)) for name, text in own.items()}
    return found


def _exact(cosines: FloatArray) -> FloatArray:
    return np.where(np.abs(cosines) < _ROUNDING, 0.0, cosines)


def _joint(turns: FloatArray, p: FloatArray, u: FloatArray) -> dict[str, str]:
    """Return the functions of joint @, whose sums have no term that is always zero."""
    R = [
        [_sum(zip(turns[:, r, k], ("", "c", "s"), strict=True)) for k in range(3)] for r in range(3)
    ]
    beyond = [[(1.0, f"a.{x}"), (p[k], "")] for k, x in enumerate(_AXES)]
    turning = [[(1.0, f"w.{x}"), (u[k], "v")] for k, x in enumerate(_AXES)]
    driven = [
        [(1.0, f"dw.{x}"), (u[k], "a"), *((factor, f"v * {of}") for factor, of in swung)]
        for k, (x, swung) in enumerate(zip(_AXES, _cross("w", u), strict=True))
    ]
    cosines = "double c, double s, vec a"
    return {
        "to_child": _vec("to_child", cosines, map(_dot, zip(*R, strict=True))),
        "to_parent": _vec("to_parent", cosines, map(_dot, R)),
        "across": "/* a x p, with p from the joint before. */\n"
        + _vec("across", "vec a", map(_sum, _cross("a", p))),
        "beyond": "/* a + p */\n" + _vec("beyond", "vec a", map(_sum, beyond)),
        "turning": "/* w + u v, with u along the axis. */\n"
        + _vec("turning", "vec w, double v", map(_sum, turning)),
        "driven": "/* dw + u a + (w x u) v */\n"
        + _vec("driven", "vec dw, vec w, double v, double a", map(_sum, driven)),
        "along": _function("double", "along", "vec a", _sum(zip(u, _names("a"), strict=True))),
    }


def _vec(name: str, parameters: str, entries: Iterable[str]) -> str:
    return _function("vec", name, parameters, f"(vec){{{', '.join(entries)}}}")


def _function(kind: str, name: str, parameters: str, value: str) -> str:
    given = (declared.split()[1] for declared in parameters.split(", "))
    unused = "".join(f"    (void){own};\n" for own in given if not re.search(rf"\b{own}\b", value))
    return f"static inline {kind} {name}_@({parameters})\n{{\n{unused}    return {value};\n}}\n\n"


def _names(vector: str) -> list[str]:
    return [f"{vector}.{x}" for x in _AXES]


def _cross(vector: str, b: FloatArray) -> list[list[_Term]]:
    """Return the terms of a vector times a constant one."""
    x, y, z = _names(vector)
    return [[(b[2], y), (-b[1], z)], [(b[0], z), (-b[2], x)], [(b[1], x), (-b[0], y)]]


def _dot(entries: Iterable[str]) -> str:
    """Return the product of a vector, whose entries are sums, with a."""
    terms = [
        f"({entry}) * {of}" if " + " in entry else f"{entry} * {of}"
        for entry, of in zip(entries, _names("a"), strict=True)
        if entry != _NOTHING
    ]
    return " + ".join(terms) or _NOTHING


def _sum(terms: Iterable[_Term]) -> str:
    """Return a sum of those terms that are not zero; a term of nothing is its factor."""
    return " + ".join(_term(*each) for each in terms if each[0] != 0.0) or _NOTHING


def _term(factor: float, of: str) -> str:
    if not of:
        return number(factor)
    return {1.0: of, -1.0: f"-{of}"}.get(factor, f"{number(factor)} * {of}")


@dataclass(frozen=True)
class LearnedCode:
    """What is added to the simulation."""

    defines: dict[str, float] = field(default_factory=dict[str, float])
    tables: str = ""
    sources: tuple[str, ...] = ()  # files of `code/`
    joints: tuple[float, ...] = ()  # memory of all joints before the first sample
    network: int = 0  # size of the network's memory, which begins with zeros


@singledispatch
def learned(model: object, rate: float) -> LearnedCode:  # noqa: ARG001  # of those that remember
    """Return what a model has learned, for samples at a rate [Hz].

    Raises:
        ConfigError: The kind of model, or of network, has no form in C.
        ModelStoreError: A network's memory cannot have this rate.
    """
    name = getattr(model, "name", type(model).__name__)
    raise ConfigError(
        f"a model of kind {name} has no form in C; expected joint-physics, {_NETWORKS}"
    )


@learned.register
def _(model: SimulationOnly, rate: float) -> LearnedCode:  # noqa: ARG001
    return LearnedCode()


@learned.register
def _(model: JointPhysics, rate: float) -> LearnedCode:  # noqa: ARG001  # it has no clock
    fitted, columns = model.fitted, model.columns
    calibration, base = fitted.calibration, columns.base
    packed = fitted.prediction
    friction = columns.friction
    others = np.setdiff1d(np.arange(columns.count), friction)
    kept = np.split(packed.kept, np.cumsum(packed.sizes)[:-1])
    kept_others = [np.searchsorted(others, own[friction.size :]) for own in kept]
    tables = {
        "base": base,
        "width": terms.WIDTHS,
        "speed": terms.SPEEDS,
        "sharp": terms.SHARP,
        "size": packed.sizes,
        "kept": np.concatenate(kept_others),
        "order": prediction.ORDER,
        "next": prediction.NEXT,
        "friction_weight": _side_by_side(fitted.weights[:, friction].transpose(0, 2, 1)),
        "weight": _side_by_side(fitted.weights[:, others]),
        "root_size": packed.root_sizes,
        "certain": calibration.certain,
        "unsure": calibration.unsure,
        "farthest": calibration.farthest,
        "fading": calibration.fading,
        "usual": calibration.usual,
        "fastest": calibration.fastest,
        "height": _side_by_side(fitted.unknown.heights.transpose(0, 2, 1)),
        "moment": _side_by_side(fitted.unknown.moments),
    }
    return LearnedCode(
        {
            "BASE": base.size,
            "STOPS": terms.WIDTHS.size,
            "SPEEDS": terms.SPEEDS.size,
            "SHARPS": terms.SHARP.size,
            "STATES": terms.STATES,
            "HARMONICS": terms.HARMONICS,
            "WAVES": 2 * terms.FRICTION_HARMONICS,
            "FAMILIES": prediction.GROUP,
            "NOTHING_BETWEEN": prediction.NOTHING,
            "OTHERS": others.size,
            "DIRECTIONS": terms.SPEEDS.size + terms.SHARP.size,
            "LANES": prediction.LANES,
            "WIDEST": prediction.padded(int(packed.sizes.max()), prediction.LANES)
            + prediction.LANES,
            "SETTLED": terms.SETTLED,
            "FASTER": FASTER,
            "STEP_TIME": columns.step_time,
            "DIFFERENCE": terms.DIFFERENCE,
            "COS_DIFFERENCE": np.cos(terms.DIFFERENCE),
            "SIN_DIFFERENCE": np.sin(terms.DIFFERENCE),
        },
        "".join(table(name, values) for name, values in tables.items())
        + table("root", packed.roots, aligned=prediction.LANES * packed.roots.itemsize),
        ("joint_physics.c",),
        tuple(_side_by_side(columns.init()).ravel()),
    )


def _side_by_side(values: FloatArray) -> FloatArray:
    """Return values of each joint (n, ...) with the joints last, filled up with zeros."""
    n = len(values)
    filled = np.zeros((*values.shape[1:], prediction.padded(n, SIDE_BY_SIDE)))
    filled[..., :n] = np.moveaxis(values, 0, -1)
    return filled


@learned.register
def _(model: HybridModel, rate: float) -> LearnedCode:
    fitted = model.fitted
    network = _network(fitted.network, fitted.stride(rate))
    features, scaling = fitted.features, fitted.inputs
    tables = {
        "stop_width": np.array(features.stop_widths or (0.0,)),
        "direction_speed": np.array(features.direction_speeds or (1.0,)),
        "place": features.places,
        "joint_input": fitted.columns,
        "input_mean": scaling.mean,
        "input_std": scaling.std,
        "lowest": scaling.lowest,
        "highest": scaling.highest,
        "output_slope": fitted.slope,
        "output_offset": fitted.offset,
        "error": fitted.error,
        "unknown": fitted.outputs.std,
        "part_input": fitted.network.columns,
    }
    own = {
        "REVERSAL": features.reversal,
        "SATURATION": features.saturation,
        "FEATURE_MEMORY": features.init().shape[1],
        "FEATURE_STOPS": len(features.stop_widths),
        "FEATURE_SPEEDS": len(features.direction_speeds),
        "HAS_DEFLECTION": int(features.compliance != 0.0),
        "COMPLIANCE": float(features.compliance),
        "QUANTITIES": features.places.size,
        "INPUTS": len(features.inputs),
        "JOINT_INPUTS": fitted.columns.shape[1],
        "STANDALONE": int(fitted.standalone),
        "PARTS": fitted.network.columns.shape[0],
        "PART_INPUTS": fitted.network.columns.shape[1],
        "PART_OUTPUTS": fitted.network.outputs // fitted.network.columns.shape[0],
    }
    return LearnedCode(
        own | network.defines,
        "".join(table(name, values) for name, values in tables.items()) + network.tables,
        (*network.sources, "network.c"),
        tuple(features.init().ravel()),
        network.network,
    )


@singledispatch
def _network(network: Network, stride: int) -> LearnedCode:  # noqa: ARG001
    raise ConfigError(f"a network of kind {network.kind} has no form in C; expected {_NETWORKS}")


@_network.register
def _(network: Mlp, stride: int) -> LearnedCode:
    weights = "".join(table(name, values) for name, values in network.weights.items())
    memory, read = network.init(stride).size, network.weights["hidden_weight"].shape[1]
    own = {"STRIDE": float(stride), "STATES": (read - network.columns.shape[1]) // 2, "READ": read}
    return LearnedCode({"HIDDEN": network.hidden, **own}, weights, ("mlp.c",), network=memory)


@_network.register
def _(network: Lstm, stride: int) -> LearnedCode:
    units, memory = network.units, network.init(stride).size
    layer = isinstance(network, LstmFcl)
    last = ("output_weight", "output_bias") if layer else ()
    return LearnedCode(
        {
            "GATES": network.gates,
            "STATES": network.states,
            "LAYERS": units.size,
            "STRIDE": float(stride),
            "CELLS": (memory - 1) // stride,
            "WIDEST": max(int(units.max()), network.columns.shape[1]),
            "HAS_LAYER": int(layer),
        },
        table("units", units)
        + table("cell_weight", network.packed)
        + "".join(table(name, network.weights[name]) for name in last),
        ("lstm.c",),
        network=memory,
    )
