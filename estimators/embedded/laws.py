"""The effects of a simulation as C: a statement each, and what they remember.

A statement finds the motion `q`, `v`, `a` of all joints and their `load`, and adds to `friction`,
`other` torque or `displacement`; one of a sensor changes `torque`. Its memory is `m`. The laws that
need more than a line are functions of `code/laws.c`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Final

import numpy as np

from estimators.embedded.tables import number, table
from limo_driver import physics
from limo_driver.errors import ConfigError
from limo_driver.physics.domain import NARROWEST
from limo_driver.physics.effects.friction import SIGN_WIDTH, VelocityFriction
from limo_driver.physics.effects.hysteresis import LAWS
from limo_driver.quoting import in_c_comment

_NAN: Final = float("nan")
_SPARE: Final = 1.1  # times the samples that a delay holds: a stream may run faster by 1 %
_NEEDS: Final = {  # functions that a function calls, itself among them
    "interpolated": ("interpolated",),
    "warmth": ("warmth",),
    "maxwell_slip": ("stepped", "maxwell_slip"),
    "lugre": ("stepped", "lugre"),
    "dahl": ("stepped", "dahl"),
    "bouc_wen": ("stepped", "bouc_wen"),
    "preisach": ("preisach",),
    "play": ("inertia", "play"),
    "swing": ("inertia", "held", "swing"),
    "loose": ("loose",),
    "wound": ("wound",),
    "late": ("interpolated", "late"),
}


@dataclass(frozen=True)
class LawCode:
    """An effect as C."""

    statement: str = ""  # none for what is in the rigid body
    memory: tuple[float, ...] = ()  # before the first sample
    function: str = ""  # of `code/laws.c`, that the statement calls
    tables: tuple[tuple[str, tuple[float, ...]], ...] = ()  # names and values, for the statement


@dataclass(frozen=True)
class EffectsCode:
    """All effects of a simulation as C."""

    acting: str  # statements, in order
    sensing: str
    functions: frozenset[str]
    memory: tuple[float, ...]
    displaces: bool

    @classmethod
    def of(cls, effects: Sequence[physics.Effect], rate: float) -> EffectsCode:
        """Write effects for samples at a rate [Hz].

        Raises:
            ConfigError: One has no form in C.
        """
        acting, sensing, memory = list[str](), list[str](), list[float]()
        functions = set[str]()
        for effect in effects:
            code = _late(effect, rate) if isinstance(effect, physics.TimeDelay) else law(effect)
            code = _in_domain(effect, code)
            (sensing if isinstance(effect, physics.SensorEffect) else acting).append(
                _block(effect, code, len(memory))
            )
            functions.update(_NEEDS.get(code.function, ()))
            memory.extend(code.memory)
        text = "".join(acting)
        return cls(
            text, "".join(sensing), frozenset(functions), tuple(memory), "displacement" in text
        )


def _in_domain(effect: physics.Effect, code: LawCode) -> LawCode:
    """Return an effect's code that beyond its domain goes on as `TorqueEffect.evaluate` does."""
    if not isinstance(effect, physics.TorqueEffect) or effect.domain is None:
        return code
    domain = effect.domain
    target, _, value = code.statement.partition(" += ")
    q, v = f"q[{effect.joints[0] - 1}]", f"v[{effect.joints[0] - 1}]"
    if domain.position is not None:
        low, high = map(number, domain.position)
        held = f"fmin(fmax({q}, {low}), {high})"
        span = number(max(domain.position[1] - domain.position[0], NARROWEST))
        fade = f"fmax(1.0 - fabs({q} - {held}) / {span}, 0.0)"
        if isinstance(effect, physics.TorqueRipple):
            value = f"({value}) * {fade}"
        elif isinstance(effect, physics.PositionDependentFriction):
            mean = f"{number(effect.mean)} * {_sign(effect.joint, effect.v_eps)}"
            value = f"{value.replace(q, held)} * {fade} + {mean} * (1.0 - {fade})"
        elif isinstance(effect, physics.SpringLoad):
            more = f"{number(effect.stiffness)} * ({q} - {held})"
            value = f"{value.replace(q, held)} + {more}"
    if domain.speed is not None and isinstance(effect, VelocityFriction):
        fastest = number(domain.speed)
        held = f"fmin(fmax({v}, -{fastest}), {fastest})"
        slopes = effect.slopes if domain.slope is None else (domain.slope, domain.slope)
        up, down = map(number, slopes)
        more = f"({v} > 0.0 ? {up} : {down}) * ({v} - {held})"
        value = f"({value.replace(v, held)}) + {more}"
    return replace(code, statement=f"{target} += {value}")


def _block(effect: physics.Effect, code: LawCode, start: int) -> str:
    if not code.statement:
        return ""
    own = "".join("        " + table(name, values) for name, values in code.tables)
    if code.memory:
        own += f"        double *m = memory->effects + {start};\n"
    return f"    {{ /* {in_c_comment(effect.place)} */\n{own}        {code.statement};\n    }}\n"


@singledispatch
def law(effect: physics.Effect) -> LawCode:
    """Return an effect as C.

    Raises:
        ConfigError: It has no form in C.
    """
    raise ConfigError(
        f"{effect.place}: has no form in C; take it out of the simulation, or identify and train "
        "without it"
    )


@law.register(physics.Payload)
@law.register(physics.GravityDirection)
def _(effect: physics.Payload | physics.GravityDirection) -> LawCode:  # noqa: ARG001  # it is in the rigid body
    return LawCode()


def _sign(joint: int, width: float) -> str:
    """Return the smoothed sign of the velocity of a joint, numbered from 1."""
    return f"tanh(v[{joint - 1}] / {number(width)})"


def _dry(height: str, joint: int, width: float) -> LawCode:
    return LawCode(f"friction[{joint - 1}] += {height} * {_sign(joint, width)}")


@law.register
def _(effect: physics.CoulombFriction) -> LawCode:
    return _dry(number(effect.tau_c), effect.joint, effect.v_eps)


@law.register
def _(effect: physics.AsymmetricFriction) -> LawCode:
    plus, minus = number(effect.tau_plus), number(effect.tau_minus)
    return _dry(f"(v[{effect.joint - 1}] > 0.0 ? {plus} : {minus})", effect.joint, effect.v_eps)


@law.register
def _(effect: physics.StribeckFriction) -> LawCode:
    speed = f"fabs(v[{effect.joint - 1}] / {number(effect.v_s)})"
    fade = f"exp(-pow({speed}, {number(effect.delta)}))"
    return _dry(f"{number(effect.tau_s)} * {fade}", effect.joint, effect.v_eps)


@law.register
def _(effect: physics.ViscousFriction) -> LawCode:
    j, (plus, minus) = effect.joint - 1, map(number, effect.coefficients)
    return LawCode(f"friction[{j}] += (v[{j}] > 0.0 ? {plus} : {minus}) * v[{j}]")


@law.register
def _(effect: physics.QuadraticDrag) -> LawCode:
    j = effect.joint - 1
    return LawCode(f"friction[{j}] += {number(effect.coefficient)} * v[{j}] * fabs(v[{j}])")


@law.register
def _(effect: physics.LoadDependentFriction) -> LawCode:
    j = effect.joint - 1
    resisting = f"(v[{j}] > 0.0 ? load[{j}] : v[{j}] < 0.0 ? -load[{j}] : 0.0)"
    pressing = {
        "absolute": f"fabs(load[{j}])",
        "positive": f"fmax({resisting}, 0.0)",
        "negative": f"fmax(-{resisting}, 0.0)",
        "stribeck": f"fabs(load[{j}]) * exp(-fabs(v[{j}] / {number(effect.v_s or 1.0)}))",
        "quadratic": f"load[{j}] * load[{j}]",
    }[effect.variant]
    return _dry(f"{number(effect.coefficient)} * {pressing}", effect.joint, effect.v_eps)


@law.register
def _(effect: physics.PositionDependentFriction) -> LawCode:
    j = effect.joint - 1
    height = f"interpolated(q[{j}], {len(effect.positions)}, at, excess)"
    return LawCode(
        f"friction[{j}] += {height} * {_sign(effect.joint, effect.v_eps)}",
        function="interpolated",
        tables=(("at", effect.positions), ("excess", effect.excess)),
    )


@law.register
def _(effect: physics.TemperatureDependentFriction) -> LawCode:
    if effect.excess is None or effect.time_constant is None:
        raise ConfigError(
            f"{effect.place}: per_kelvin needs the temperature of the joint, which no stream has; "
            "give excess and time_constant"
        )
    j = effect.joint - 1
    cold = f"(1.0 - warmth(m, time, v[{j}], {number(effect.time_constant)}))"
    dry = _dry(f"{number(effect.excess)} * {cold}", effect.joint, effect.v_eps)
    return replace(dry, memory=tuple(effect.initial_state()), function="warmth")


@law.register
def _(effect: physics.PreslidingHysteresis) -> LawCode:
    j, given = effect.joint - 1, [getattr(effect, name) for name in LAWS[effect.law].parameters]
    arguments, tables = [f"q[{j}]"], list[tuple[str, tuple[float, ...]]]()
    if effect.law == "lugre":
        arguments.append(f"v[{j}]")
    if isinstance(given[0], tuple):
        names = LAWS[effect.law].parameters
        tables = [(name, values) for name, values in zip(names, given, strict=True)]
        arguments += [str(len(given[0])), *names]
    else:
        arguments += [number(value) for value in given]
    text = f"friction[{j}] += {effect.law}(m, {', '.join(arguments)})"
    return LawCode(text, tuple(effect.initial_state()), effect.law, tuple(tables))


@law.register
def _(effect: physics.Armature) -> LawCode:
    j = effect.joint - 1
    return LawCode(f"other[{j}] += {number(effect.inertia)} * a[{j}]")


@law.register
def _(effect: physics.TorqueOffset) -> LawCode:
    return LawCode(f"other[{effect.joint - 1}] += {number(effect.offset)}")


@law.register
def _(effect: physics.TorqueDrift) -> LawCode:
    text = f"other[{effect.joint - 1}] += interpolated(time, {len(effect.times)}, at, offset)"
    tables = (("at", effect.times), ("offset", effect.offset))
    return LawCode(text, function="interpolated", tables=tables)


@law.register
def _(effect: physics.TorqueRipple) -> LawCode:
    j = effect.joint - 1
    lines = zip(effect.cycles_per_rev, effect.amplitude, effect.phase, strict=True)
    waves = [f"{number(A)} * sin({number(N)} * q[{j}] + {number(phi)})" for N, A, phi in lines]
    return LawCode(f"other[{j}] += {' + '.join(waves) or '0.0'}")


@law.register
def _(effect: physics.SpringLoad) -> LawCode:
    j, away = effect.joint - 1, f"(q[{effect.joint - 1}] - {number(effect.rest)})"
    slope = f"({number(effect.stiffness)} + {number(effect.cubic)} * {away} * {away})"
    return LawCode(f"other[{j}] += {away} * {slope}")


@law.register
def _(effect: physics.JointCoupling) -> LawCode:
    j, k, ratio = effect.joint - 1, effect.other - 1, number(effect.ratio)
    w, rate = (f"({x}[{j}] + {ratio} * {x}[{k}])" for x in "va")
    dry = f"{number(effect.tau_c)} * tanh({w} / {number(effect.v_eps)})"
    return LawCode(
        f"friction[{j}] += {number(effect.f_v)} * {w} + {dry};\n"
        f"        other[{j}] += {number(effect.inertia)} * {rate}"
    )


@law.register
def _(effect: physics.EncoderOffset) -> LawCode:
    return LawCode(f"displacement[{effect.joint - 1}] += {number(effect.offset)}")


@law.register
def _(effect: physics.JointElasticity) -> LawCode:
    j = effect.joint - 1
    linear, cubic = number(1.0 / effect.stiffness), number(effect.cubic)
    if effect.damping is None:
        slope = f"({linear} + {cubic} * load[{j}] * load[{j}])"
        return LawCode(f"displacement[{j}] += load[{j}] * {slope}")
    body = f"load[{j}], inertia(q, {j}), isnan(m[5]) ? held(q, {j}) : 0.0"
    text = (
        f"displacement[{j}] += swing(m, time, {body}, {linear}, {cubic}, {number(effect.damping)})"
    )
    return LawCode(text, tuple(effect.initial_state()), "swing")


@law.register
def _(effect: physics.Backlash) -> LawCode:
    j = effect.joint - 1
    if effect.drag is not None:
        dry = f"{number(effect.drag)} * {_sign(effect.joint, effect.v_eps or SIGN_WIDTH)}"
        if effect.width is not None:
            felt = f"wound(m, q[{j}], {number(effect.gap / 2)}, {number(effect.width)})"
            text = f"friction[{j}] += {number(effect.drag)} * {felt} - {dry}"
            return LawCode(text, tuple(effect.initial_state()), "wound")
        text = f"friction[{j}] -= {dry} * loose(m, q[{j}], v[{j}], {number(effect.gap / 2)})"
        return LawCode(text, tuple(effect.initial_state()), "loose")
    slowed, flank = number(effect.damping or 0.0), number(effect.gap / 2)
    text = (
        f"const double moved = inertia(q, {j}); "
        f"displacement[{j}] += play(m, time, load[{j}] / moved, {slowed} / moved, {flank})"
    )
    return LawCode(text, tuple(effect.initial_state()), "play")


@law.register
def _(effect: physics.TorqueGain) -> LawCode:
    j = effect.joint - 1
    return LawCode(f"torque[{j}] += {number(effect.gain)} * torque[{j}]")


@law.register
def _(effect: physics.TorqueCrosstalk) -> LawCode:
    source = effect.source - 1
    return LawCode(f"torque[{effect.joint - 1}] += {number(effect.gain)} * torque[{source}]")


def _late(effect: physics.TimeDelay, rate: float) -> LawCode:
    """Return a delay, whose memory holds the torques of its time at a rate [Hz]."""
    j, most = effect.joint - 1, math.ceil(_SPARE * effect.delay * rate) + 3
    times = f"{number(effect.delay)}, {number(effect.lag)}"
    memory = np.zeros(4 + 2 * most)
    memory[0] = _NAN
    return LawCode(
        f"torque[{j}] = late(m, {most}, time, torque[{j}], {times})", tuple(memory), "late"
    )
