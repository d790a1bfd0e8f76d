"""What a model has learned as C: constants, tables and the code that takes them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import singledispatch
from typing import TYPE_CHECKING

import numpy as np

from estimators.embedded.tables import SIDE_BY_SIDE, table
from estimators.hybrid import HybridModel
from estimators.joint_physics import JointPhysics, prediction
from estimators.joint_physics import columns as terms
from estimators.neural.lstm import Lstm, LstmFcl
from estimators.neural.mlp import Mlp
from estimators.residual_model import SimulationOnly
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from estimators.neural import Network
    from limo_driver.types import FloatArray


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
        f"a model of kind {name} has no form in C; expected joint-physics, mlp7, lstm-2 or lstm-fcl"
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
        "fading": calibration.fading,
        "farthest": calibration.farthest,
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
    raise ConfigError(
        f"a network of kind {network.kind} has no form in C; expected mlp7, lstm-2 or lstm-fcl"
    )


@_network.register
def _(network: Mlp, stride: int) -> LearnedCode:  # noqa: ARG001  # it has no memory
    weights = "".join(table(name, values) for name, values in network.weights.items())
    return LearnedCode({"HIDDEN": network.hidden}, weights, ("mlp.c",))


@_network.register
def _(network: Lstm, stride: int) -> LearnedCode:
    units, memory = network.units, network.init(stride).size
    layer = isinstance(network, LstmFcl)
    last = ("output_weight", "output_bias") if layer else ()
    return LearnedCode(
        {
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
