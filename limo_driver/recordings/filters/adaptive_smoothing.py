"""Differentiate positions at the bandwidth that they need: sharp where they move, calm at rest.

Dry friction follows the sign of the velocity. A filter that is sharp enough for a reversal lets so
much of the encoder's noise through at rest that the friction predicted there chatters by its full
height. So the bandwidth changes with time, as the positions themselves ask for.

Each joint is a third integral of white noise, q''' = w, seen with white noise of the encoder. Its
smoother has no phase and the response 1 / (1 + (f / b)^6), so the strength of w is a bandwidth b.
Which of a few bandwidths holds is a Markov chain, estimated at every sample from the past, from the
future, and from both together; one smoother then runs with the strength of w that is to be expected
of all of them. An arm that rests is averaged over half a second, and one that starts, stops or
reverses is not: a little probability of a start already sharpens the smoother.

Source: Blom and Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian
switching coefficients", 1988; Bryson and Frazier, "Smoothing for linear and nonlinear dynamic
systems", 1963, of which the last pass takes no inverse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from limo_driver.recordings.filters.differentiation import Derivatives, impulse_responses, smooth
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray

_CALMER: Final = (1.0, 0.25, 0.0625)  # times the sharpest bandwidth; more of them gain nothing
_SWITCHES: Final = 0.1  # [1/s], from each to another; ten times less or more changes little
_WINDOW: Final = 0.25  # [s] in which noise is taken for even
_NOTHING: Final = 1e-9  # [rad]; less noise than any encoder's
_LEAST_NOISE: Final = 1e-5  # of the widest step between two samples; less is lost in the arithmetic
_REACH: Final = 3.0  # [1/bandwidth], after which a filter's response is negligible
_LEAST_CHANCE: Final = 1e-12  # of a bandwidth, lest it can never come back
_MOST_LEAVING: Final = 0.5  # chance per sample, however long it lasts


def differentiate_adaptively(
    time: FloatArray, position: FloatArray, bandwidth: float, segments: Sequence[slice]
) -> Derivatives:
    """Smooth positions and differentiate them twice, at the bandwidth that they need.

    The noise of the encoder is estimated, joint by joint, from what is above `bandwidth`. Where
    there is none, the bandwidth is what is given everywhere.

    Args:
        time: (T,) [s], strictly increasing.
        position: (T, n) [rad].
        bandwidth: The highest, at which the amplitude is halved [Hz].
        segments: Contiguous stretches that cover all rows; nothing passes between them.

    Returns:
        Position, velocity and acceleration at the given instants, (T, n) each.

    Raises:
        RecordingError: The bandwidth is too high for the sampling rate, or too low for its length.
    """
    moved = np.zeros((3, *position.shape))
    for rows in segments:
        own = np.ascontiguousarray(time[rows] - time[rows.start])
        noise = encoder_noise(own, position[rows], bandwidth)
        for j, sigma in enumerate(noise):
            at_first = position[rows.start, j]
            away = position[rows, j] - at_first
            widest = float(np.abs(np.diff(away)).max())
            moved[0, rows, j] = at_first
            if widest:  # else it stands still
                unit = max(sigma, _LEAST_NOISE * widest)
                moved[:, rows, j] += unit * _differentiated(own, away / unit, bandwidth)
    return Derivatives(moved[0], moved[1], moved[2])


def _differentiated(time: FloatArray, q: FloatArray, bandwidth: float) -> FloatArray:
    """Return position and derivatives (3, T) of positions (T,) in units of their noise."""
    period = float(np.median(np.diff(time)))
    driven = (2 * np.pi * bandwidth * np.array(_CALMER)) ** 6 * period
    fastest = float(np.abs(np.diff(q)).max()) / period
    scale = np.array([fastest, fastest / period])
    chances = np.full((4, q.size, driven.size), 1.0 / driven.size)
    _chances(time, q, driven, scale, chances[0], chances[1])
    back, reversed_q = time[-1] - time[::-1], np.ascontiguousarray(q[::-1])
    _chances(back, reversed_q, driven, scale, chances[2], chances[3])
    both = chances[1] * chances[2, ::-1]  # seen up to here, and foreseen from what follows
    means = np.empty((q.size, 3))
    _smooth(time, q, both @ driven / both.sum(axis=1), scale, means)
    return means.T


def encoder_noise(time: FloatArray, position: FloatArray, bandwidth: float) -> FloatArray:
    """Estimate the noise of positions from what of them is above a bandwidth.

    It is the median over short windows, so that neither an impact nor a rest at which a coarse
    encoder stands still counts: windows without any are left out.

    Args:
        time: (T,) [s], strictly increasing and without a gap.
        position: (T, n) [rad].
        bandwidth: Above that of all motion [Hz].

    Returns:
        Standard deviation of white noise, (n,) [rad]; 0 where there is none.

    Raises:
        RecordingError: The bandwidth is too high for the sampling rate, or too low for its length.
    """
    above = position - smooth(time, position, bandwidth, [slice(0, time.size)])
    rate = 1.0 / float(np.median(np.diff(time)))
    response = impulse_responses(bandwidth, rate, math.ceil(_REACH / bandwidth * rate))[0]
    kept = 1.0 - 2.0 * response[response.size // 2] + float(response @ response)
    length = min(max(round(_WINDOW * rate), 1), time.size)
    windows = above[: time.size // length * length].reshape(-1, length, position.shape[1])
    power = np.mean(windows**2, axis=1) / kept  # (windows, n)
    found = [own[own > _NOTHING**2] for own in power.T]
    return np.array([math.sqrt(np.median(own)) if own.size else 0.0 for own in found])


@compiled()
def _move(x: FloatArray, P: FloatArray, dt: float, driven: float) -> None:
    """Advance mean (3,) and covariance (6,), upper triangle by rows, by dt [s], in place."""
    h = 0.5 * dt * dt
    x[0] += dt * x[1] + h * x[2]
    x[1] += dt * x[2]
    P[0] += 2 * dt * P[1] + 2 * h * P[2] + dt * dt * P[3] + 2 * dt * h * P[4] + h * h * P[5]
    P[1] += dt * P[3] + h * P[4] + dt * (P[2] + dt * P[4] + h * P[5])
    P[2] += dt * P[4] + h * P[5]
    P[3] += 2 * dt * P[4] + dt * dt * P[5]
    P[4] += dt * P[5]
    noise = driven * dt
    P[5] += noise
    P[4] += noise * dt / 2
    P[3] += noise * dt**2 / 3
    P[2] += noise * dt**2 / 6
    P[1] += noise * dt**3 / 8
    P[0] += noise * dt**4 / 20


@compiled()
def _see(x: FloatArray, P: FloatArray, error: float) -> float:
    """Take a position, seen with noise 1, `error` from the mean; return the error's variance."""
    variance = P[0] + 1.0
    p0, p1, p2 = P[0], P[1], P[2]
    g0, g1, g2 = p0 / variance, p1 / variance, p2 / variance
    x[0] += g0 * error
    x[1] += g1 * error
    x[2] += g2 * error
    P[0] -= g0 * p0
    P[1] -= g0 * p1
    P[2] -= g0 * p2
    P[3] -= g1 * p1
    P[4] -= g1 * p2
    P[5] -= g2 * p2
    return variance


@compiled()
def _mix(
    x: FloatArray, P: FloatArray, weights: FloatArray, mixed: FloatArray, spread: FloatArray
) -> None:
    """Set mean (3,) and covariance (6,) to those of a mixture of K, by weights (K,)."""
    for a in range(3):
        mixed[a] = 0.0
        for i in range(weights.size):
            mixed[a] += weights[i] * x[i, a]
    k = 0
    for a in range(3):
        for b in range(a, 3):
            spread[k] = 0.0
            for i in range(weights.size):
                off = (x[i, a] - mixed[a]) * (x[i, b] - mixed[b])
                spread[k] += weights[i] * (P[i, k] + off)
            k += 1


@compiled()
def _leave(chances: FloatArray, k: int, leave: float, weights: FloatArray) -> float:
    """Set the shares (K,) of where strength k was reached from; return its chance now."""
    total = 0.0
    for i in range(chances.size):
        weights[i] = chances[i] * (1.0 - leave if i == k else leave / (chances.size - 1))
        total += weights[i]
    for i in range(chances.size):
        weights[i] /= total
    return total


@compiled()
def _weigh(before: FloatArray, log_likelihoods: FloatArray, after: FloatArray) -> None:
    """Set chances (K,) after a sample whose likelihoods are given; none falls to nothing."""
    best = log_likelihoods.max()
    total = 0.0
    for k in range(before.size):
        after[k] = before[k] * math.exp(log_likelihoods[k] - best)
        total += after[k]
    for k in range(before.size):
        after[k] = max(after[k] / total, _LEAST_CHANCE)


@compiled(nogil=True)
def _chances(
    time: FloatArray,
    q: FloatArray,
    driven: FloatArray,
    scale: FloatArray,
    before: FloatArray,
    after: FloatArray,
) -> None:
    """Find the chance of each of K strengths before and after each sample is seen.

    Args:
        time: (T,) [s].
        q: Positions in units of their noise, (T,).
        driven: The strengths [1/s⁵].
        scale: Of velocity and acceleration before the first sample, (2,) [1/s], [1/s²].
        before: Filled, (T, K); as the first row of both is given, so it stays.
        after: Likewise.
    """
    K = driven.size
    x, spread = np.zeros((K, 3)), np.zeros((K, 6))
    mixed, wider = np.zeros((K, 3)), np.zeros((K, 6))
    weights, likely = np.zeros(K), np.zeros(K)
    for k in range(K):
        x[k, 0], spread[k, 0], spread[k, 3], spread[k, 5] = q[0], 1.0, scale[0] ** 2, scale[1] ** 2
    for t in range(1, q.size):
        dt = time[t] - time[t - 1]
        leave = min(_SWITCHES * dt, _MOST_LEAVING)
        for k in range(K):
            before[t, k] = _leave(after[t - 1], k, leave, weights)
            _mix(x, spread, weights, mixed[k], wider[k])
        for k in range(K):
            _move(mixed[k], wider[k], dt, driven[k])
            error = q[t] - mixed[k, 0]
            variance = _see(mixed[k], wider[k], error)
            likely[k] = -0.5 * (error * error / variance + math.log(variance))
        x, mixed, spread, wider = mixed, x, wider, spread
        _weigh(before[t], likely, after[t])


@compiled(nogil=True)
def _smooth(
    time: FloatArray, q: FloatArray, driven: FloatArray, scale: FloatArray, means: FloatArray
) -> None:
    """Fill `means` (T, 3) with position and derivatives, given all positions; see `_chances`.

    Here the strength is one for each sample, (T,).
    """
    T = q.size
    spreads, errors, variances = np.empty((T, 6)), np.empty(T), np.empty(T)
    x, spread = np.zeros(3), np.zeros(6)
    x[0], spread[0], spread[3], spread[5] = q[0], 1.0, scale[0] ** 2, scale[1] ** 2
    for t in range(T):
        if t:
            _move(x, spread, time[t] - time[t - 1], 0.5 * (driven[t] + driven[t - 1]))
        for k in range(3):
            means[t, k] = x[k]
        for k in range(6):
            spreads[t, k] = spread[k]
        errors[t] = q[t] - x[0]
        variances[t] = _see(x, spread, errors[t])
    p0, p1, p2 = 0.0, 0.0, 0.0  # the pull of the samples to come
    for t in range(T - 1, -1, -1):
        own = spreads[t]
        p0 -= (own[0] * p0 + own[1] * p1 + own[2] * p2 + errors[t]) / variances[t]
        means[t, 0] -= own[0] * p0 + own[1] * p1 + own[2] * p2
        means[t, 1] -= own[1] * p0 + own[3] * p1 + own[4] * p2
        means[t, 2] -= own[2] * p0 + own[4] * p1 + own[5] * p2
        if t:
            dt = time[t] - time[t - 1]
            p2 += dt * p1 + 0.5 * dt * dt * p0
            p1 += dt * p0
