"""One step of one joint behind its drive, compiled.

Implicit in all that is linear in velocity (gains, damping, inertia), and exact in dry
friction, which holds the joint still as long as it can: a joint at rest does not creep.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.simulation import constants as c
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

_PRESSED: Final = 0.01  # [N m], from which on a flank is touched
# [s]; inertia over the gain of a servo of velocity, in which it follows, is 10 ms or so
_QUICK_STEP: Final = 0.002


@compiled(nogil=True)
def follow_command(
    row: FloatArray,
    time: FloatArray,
    command: FloatArray,
    at: int,
    begin: float,
    h: float,
    target: float,
    speed: float,
) -> tuple[float, float, int]:
    """Return set-point [rad] and speed [rad/s] of the profile a step later, and the row in force.

    What is followed is the mean of the commands in force within the step, so that what is simulated
    is smooth in a delay.

    Args:
        row: The constants of the joint.
        time: (T,) [s].
        command: (T,) [rad], each in force until the next one.
        at: Row in force at `begin`.
        begin: Of the step, less the delay [s].
        h: Step [s].
        target: Set-point [rad].
        speed: Of the set-point [rad/s].
    """
    end, again, total, since = begin + h, False, 0.0, begin
    while at + 1 < time.size and time[at + 1] < end:
        until = max(time[at + 1], since)
        total += command[at] * (until - since)
        since = until
        at += 1
        again = again or command[at] == command[at - 1]  # sent once more
    wanted = (total + command[at] * (end - since)) / (end - begin)
    most, rate = row[c.SPEED], row[c.ACCELERATION]
    if (most == math.inf and rate == math.inf) or (again and row[c.STRAIGHT] > 0.0):
        return wanted, 0.0, at
    away = wanted - target
    pace = min(most, abs(away) / h)
    if rate < math.inf:
        pace = min(pace, math.sqrt(2.0 * rate * abs(away)))
        change = math.copysign(pace, away) - speed
        speed += min(max(change, -rate * h), rate * h)
    else:
        speed = math.copysign(pace, away)
    return target + speed * h, speed, at


@compiled(nogil=True)
def error_of(row: FloatArray, target: float, position: float) -> float:
    """Return the error that the servo acts on [rad].

    Of a servo of velocity, what it is told [rad/s]: the rest of its error is damping. Of a drive
    that is told torques, these [N m].
    """
    if row[c.KV] > 0.0 or row[c.GAIN] > 0.0:
        return target
    step, band = row[c.RESOLUTION], row[c.DEAD_BAND]
    if step > 0.0:
        position = step * math.floor(position / step + 0.5)
    error = target - position
    if error > band:
        return error - band
    return error + band if error < -band else 0.0


@compiled(nogil=True)
def position_integral(row: FloatArray, integral: float, error: float, h: float) -> float:
    """Return the torque of the integral [N m] a step later; of a servo of velocity, as it is."""
    if row[c.KV] > 0.0:
        return integral
    most = row[c.INTEGRAL_LIMIT]
    return min(max(integral + row[c.KI] * error * h, -most), most)


@compiled(nogil=True)
def velocity_integral(
    row: FloatArray, integral: float, commanded: float, mean: float, h: float
) -> float:
    """Return the torque of the integral [N m] of a servo of velocity behind a step.

    Args:
        row: The constants of the joint.
        integral: Before the step [N m].
        commanded: Velocity [rad/s].
        mean: That of the joint within the step [rad/s].
        h: Step [s].
    """
    if row[c.KV] == 0.0:
        return integral
    most = row[c.INTEGRAL_LIMIT]
    return min(max(integral + row[c.KI] * (commanded - mean) * h, -most), most)


@compiled(nogil=True)
def longest_step(row: FloatArray, usual: float) -> float:
    """Return the longest step [s] in which a joint is simulated.

    Args:
        row: The constants of the joint.
        usual: That behind a servo of position [s].
    """
    return min(usual, _QUICK_STEP) if row[c.KV] > 0.0 else usual


@compiled(nogil=True)
def begins_anew(row: FloatArray, begun: float, now: float) -> bool:
    """Say whether errors of a joint begin anew, as those of what drifts do from time to time.

    Args:
        row: The constants of the joint.
        begun: When they began [s]; -inf where they have not yet.
        now: [s].
    """
    return row[c.RESTART] < math.inf and now - begun >= row[c.RESTART]


@compiled(nogil=True)
def keeps_pace(row: FloatArray) -> bool:
    """Say whether a joint whose errors begin anew goes on as fast as it is simulated.

    Behind a drive that closes no loop its velocity drifts as its position does.

    Args:
        row: The constants of the joint.
    """
    return row[c.GAIN] == 0.0


@compiled(nogil=True)
def held(row: FloatArray, position: float, load: float) -> float:
    """Return the torque of an integral [N m] that holds a joint at rest.

    That of a servo of position begins with none: its error holds the joint.

    Args:
        row: The constants of the joint.
        position: [rad].
        load: Torque that the rigid body needs [N m].
    """
    if row[c.KV] == 0.0 or row[c.KI] == 0.0:
        return 0.0
    away = position - row[c.REST]
    pull = load + row[c.OFFSET] + (row[c.SPRING] + row[c.CUBIC] * away * away) * away
    most = min(row[c.INTEGRAL_LIMIT], row[c.TORQUE_LIMIT], row[c.STALL])
    return min(max(pull, -most), most)


@compiled(nogil=True)
def slack(row: FloatArray, force: float) -> float:
    """Return by how much the drive leads its joint within the play of the gear [rad].

    The force [N m] that the joint needs presses it on one flank; around none it is in between.
    """
    half = 0.5 * row[c.PLAY]
    return half * min(max(force / _PRESSED, -1.0), 1.0)


@compiled(nogil=True)
def _fading(row: FloatArray) -> float:
    """Return what a motor loses with speed, as its voltage is limited [N m s/rad]."""
    return row[c.STALL] / row[c.FREE_SPEED] if row[c.FREE_SPEED] < math.inf else 0.0


@compiled(nogil=True)
def driven(row: FloatArray, error: float, velocity: float) -> tuple[float, float]:
    """Return what a servo draws from its supply, over what it draws stalled and fully driven.

    A duty d of the voltage u, with back-EMF e, draws d (d u - e): the factor of u, and the rest.

    Args:
        row: The constants of the joint.
        error: That the servo acts on [rad].
        velocity: [rad/s].
    """
    most = min(row[c.TORQUE_LIMIT], row[c.STALL])
    duty = min(max(row[c.KP] * error / most, -1.0), 1.0)
    slope = row[c.KD] + _fading(row) + 0.5 * (row[c.VISCOUS_PLUS] + row[c.VISCOUS_MINUS])
    return duty * duty, duty * slope * velocity / most


@compiled(nogil=True)
def draws(row: FloatArray, error: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return `driven` of errors [rad] and velocities [rad/s] of T samples, (2, T)."""
    found = np.empty((2, error.size))
    for i in range(error.size):
        found[0, i], found[1, i] = driven(row, error[i], velocity[i])
    return found


@compiled(nogil=True)
def sagged(sag: float, drawn: float, returned: float) -> float:
    """Return the voltage over that of a supply without load.

    Args:
        sag: Resistance of the supply over that of a motor's winding.
        drawn: Sum of what all servos draw by voltage, as `driven` has it.
        returned: Of what their back-EMF saves.
    """
    return min((1.0 + sag * max(returned, 0.0)) / (1.0 + sag * drawn), 1.0)


@compiled(nogil=True)
def warm_motor(
    row: FloatArray, supply: float, heat: float, error: float, velocity: float, h: float
) -> tuple[float, float]:
    """Return the voltage that drives a warm motor as it would a cold one, and how warm it gets.

    Args:
        row: The constants of the joint.
        supply: Voltage over that of a supply without load.
        heat: How warm the motor is, over what it is stalled for long.
        error: That the servo acts on [rad].
        velocity: [rad/s].
        h: Step [s].
    """
    if row[c.DERATING] <= 0.0:
        return supply, heat
    duty, _ = driven(row, error, velocity)
    voltage = supply / (1.0 + row[c.DERATING] * heat)
    return voltage, heat + (duty - heat) * (1.0 - math.exp(-h / row[c.HEATING]))


# a call of its own would take the constants of the joint, one by one, as long as the step itself
@compiled(nogil=True, inline="always")
def next_velocity(
    row: FloatArray,
    position: float,
    velocity: float,
    error: float,
    integral: float,
    inertia: float,
    load: float,
    supply: float,
    h: float,
) -> tuple[float, float]:
    """Return the velocity of a joint after a step, and its mean within the step [rad/s].

    Args:
        row: The constants of the joint.
        position: [rad].
        velocity: [rad/s].
        error: That the servo acts on [rad]; what one of velocity is told [rad/s], or a drive that
            closes no loop [N m].
        integral: Torque of the servo's integral [N m].
        inertia: Of the rigid body about the joint [kg m²].
        load: Torque that the rigid body needs at no acceleration of this joint [N m].
        supply: Voltage over that of a supply without load, to which a servo's torque is in
            proportion.
        h: Step [s].
    """
    heavy = (inertia + row[c.INERTIA]) / h
    away = position - row[c.REST]
    spring = row[c.SPRING] + row[c.CUBIC] * away * away
    slope = row[c.VISCOUS_PLUS] if velocity > 0.0 else row[c.VISCOUS_MINUS]
    braked = row[c.INSIDE] * slope
    soft = slope - braked + row[c.DRAG] * abs(velocity) + 0.5 * spring * h
    passive = heavy * velocity - load - row[c.OFFSET] - spring * away
    push, stiff = integral, row[c.KD] + braked
    if row[c.KV] > 0.0:
        gain = row[c.KV] + 0.5 * row[c.KI] * h
        push += gain * error
        stiff += gain
    elif row[c.GAIN] > 0.0:
        push += row[c.GAIN] * error
    elif error != 0.0:
        push += row[c.KP] * error + math.copysign(row[c.PUNCH], error)
        stiff += 0.5 * row[c.KP] * h
    push, stiff = supply * push, supply * stiff
    after, mean = _moved(row, velocity, load, heavy, passive + push, soft + stiff)
    torque = push - stiff * mean
    if abs(torque) > supply * row[c.TORQUE_LIMIT]:
        torque = math.copysign(supply * row[c.TORQUE_LIMIT], torque)
        after, mean = _moved(row, velocity, load, heavy, passive + torque, soft)
    fading = _fading(row)
    if abs(torque + fading * mean) > supply * row[c.STALL]:
        torque = math.copysign(supply * row[c.STALL], torque + fading * mean)
        after, mean = _moved(row, velocity, load, heavy, passive + torque, soft + fading)
    return after, mean


@compiled(nogil=True)
def _moved(
    row: FloatArray, velocity: float, load: float, heavy: float, torque: float, damping: float
) -> tuple[float, float]:
    """Return the velocity after a step and its mean [rad/s]: by trapezia, which are exact to h³.

    What is damped too fast for the step would ring so, and is taken as it is at the end.
    """
    late = 0.5 if damping < 2.0 * heavy else 1.0
    early = 1.0 - late
    after = _sliding(row, torque - early * damping * velocity, velocity, load)
    after /= heavy + late * damping
    return after, early * velocity + late * after


@compiled(nogil=True)
def _sliding(row: FloatArray, torque: float, velocity: float, load: float) -> float:
    """Return what dry friction leaves of the torque that would move a joint [N m]."""
    friction = row[c.PLUS] if torque > 0.0 else row[c.MINUS]
    pressed = row[c.RESISTED] if torque * load > 0.0 else row[c.ASSISTED]
    friction += row[c.BY_LOAD] * pressed * abs(load)
    if row[c.STRIBECK] > 0.0:
        pace = abs(velocity) / row[c.V_S]
        if row[c.DELTA] != 1.0:  # a power takes as long as the rest of the step
            pace = pace ** row[c.DELTA]
        friction += row[c.STRIBECK] * math.exp(-pace)
    if abs(torque) <= friction:
        return 0.0
    return torque - math.copysign(friction, torque)
