"""What the sensors of the concealed plant make of a motion, and how it is recorded."""

from dataclasses import dataclass, field, replace

import numpy as np
from arm import N
from plant import PERIOD, Response
from scipy.signal import bessel, bilinear, butter, lfilter, sosfilt, sosfiltfilt

BAND = 10.0  # [Hz] of the band in which everything is compared
CLASS = np.array([1.0, 1.0, 0.8, 0.8, 0.6, 0.45, 0.45])  # of a joint's torque


@dataclass(frozen=True)
class Course:
    """Torque that a sensor adds over time."""

    joint: int
    kind: str  # warm_up, walk, periodic or jumps
    amplitude: float  # [N m]
    scale: float  # [s] time constant, period, or mean time between jumps
    seed: int

    def over(self, time: np.ndarray, recording: int) -> np.ndarray:
        """Return its values, (T,) [N m]; a walk and jumps differ from recording to recording."""
        random = np.random.default_rng([self.seed, recording])
        if self.kind == "warm_up":
            return self.amplitude * (1 - np.exp(-time / self.scale))
        if self.kind == "periodic":
            phase = random.uniform(0, 2 * np.pi)
            return self.amplitude * np.sin(2 * np.pi * time / self.scale + phase)
        if self.kind == "walk":
            knots = np.arange(0.0, time[-1] + self.scale, self.scale)
            walk = np.cumsum(random.normal(size=knots.size))
            return self.amplitude * np.interp(time, knots, walk - walk[0])
        at = np.cumsum(random.exponential(self.scale, int(3 * time[-1] / self.scale) + 5))
        levels = random.normal(size=at.size + 1)
        return self.amplitude * levels[np.searchsorted(at, time)]


@dataclass(frozen=True)
class Sensing:
    """Faults of the sensors, beyond noise."""

    gain: np.ndarray = field(default_factory=lambda: np.zeros(N))  # relative error
    crosstalk: np.ndarray = field(default_factory=lambda: np.zeros((N, N)))
    curve: np.ndarray = field(default_factory=lambda: np.zeros(N))  # [1/(N m)] of τ²
    offset: np.ndarray = field(default_factory=lambda: np.zeros(N))  # [N m]
    encoder_offset: np.ndarray = field(default_factory=lambda: np.zeros(N))  # [rad]
    delay: np.ndarray = field(default_factory=lambda: np.zeros(N))  # [s] pure
    lag: np.ndarray = field(default_factory=lambda: np.zeros(N))  # [s] of a low-pass, at rest
    lag_order: int = 1
    courses: tuple[Course, ...] = ()

    def at(self, name: str, joint: int, value: float) -> "Sensing":
        """Return the sensing with another value at one joint."""
        values = getattr(self, name).copy()
        values[joint] += value
        return replace(self, **{name: values})

    def torque(self, felt: np.ndarray, recording: int) -> np.ndarray:
        """Return what the sensors say, free of noise; (T, n) [N m], every millisecond."""
        time = np.arange(len(felt)) * PERIOD
        said = felt * (1 + self.gain) + felt @ self.crosstalk.T + self.curve * felt * np.abs(felt)
        said = said + self.offset
        for course in self.courses:
            said[:, course.joint] += course.over(time, recording)
        for j in range(N):
            if self.delay[j]:
                said[:, j] = np.interp(time - self.delay[j], time, said[:, j])
            if self.lag[j]:
                said[:, j] = _lagged(said[:, j], self.lag[j], self.lag_order)
        return said


def _lagged(values: np.ndarray, lag: float, order: int) -> np.ndarray:
    """Run a Bessel low-pass whose group delay at rest is `lag` [s]."""
    b, a = bessel(order, 1 / lag, norm="delay", analog=True)
    b, a = bilinear(b, a, 1 / PERIOD)
    return lfilter(b, a, values - values[0]) + values[0]


@dataclass(frozen=True)
class Instruments:
    """How everything is recorded; drawn once for each case."""

    rate: float  # [Hz] of the file
    filter: float  # [Hz] first-order filter of torque and position alike
    noise: np.ndarray  # (n,) [N m] standard deviation
    colour: float  # [Hz] corner of its spectrum
    drift: np.ndarray  # (n,) [N m]
    torque_resolution: float  # [N m]
    encoder_step: float  # [rad]
    encoder_noise: float  # [rad]
    jitter: float  # of the sample period
    velocity: bool  # recorded as well
    seed: int

    @classmethod
    def draw(cls, random: np.random.Generator) -> "Instruments":
        sigma = random.uniform(0.03, 0.05) * CLASS * random.uniform(0.85, 1.15, N)
        return cls(
            rate=float(random.choice([250.0, 250.0, 250.0, 1000.0, 125.0])),
            filter=random.uniform(120.0, 300.0),
            noise=sigma,
            colour=random.uniform(15.0, 40.0),
            drift=random.uniform(0.0, 0.15) * 0.3 * sigma,
            torque_resolution=random.choice([0.0, 0.002, 0.01]),
            encoder_step=random.uniform(0.5e-5, 1e-5),
            encoder_noise=random.uniform(0.1e-5, 0.3e-5),
            jitter=random.choice([0.0, 0.0, 0.03]),
            velocity=bool(random.random() < 0.3),
            seed=int(random.integers(2**31)),
        )

    def record(self, response: Response, sensing: Sensing, recording: int) -> "Recorded":
        """Return what is written to a file."""
        random = np.random.default_rng([self.seed, recording])
        rows = len(response.torque)
        every = np.arange(rows) * PERIOD
        time = np.arange(0.0, every[-1], 1 / self.rate)
        if self.jitter:
            time = time + self.jitter / self.rate * np.clip(random.normal(size=time.size), -3, 3)
            time = np.clip(time, 0.0, every[-1])
        clean = self._taken(sensing.torque(response.torque, recording), every, time)
        position = self._taken(response.position + sensing.encoder_offset, every, time)
        velocity = self._taken(response.velocity, every, time)
        noise = self._noise(random, time)
        torque = _rounded(clean + noise, self.torque_resolution)
        position = position + self.encoder_noise * random.normal(size=position.shape)
        return Recorded(
            time=time,
            position=_rounded(position, self.encoder_step),
            torque=torque,
            velocity=velocity + 1e-3 * random.normal(size=velocity.shape),
            heat=self._taken(response.heat, every, time),
            clean=clean,
        )

    def _taken(self, values: np.ndarray, every: np.ndarray, time: np.ndarray) -> np.ndarray:
        low = sosfilt(
            butter(1, self.filter, fs=1 / PERIOD, output="sos"), values - values[0], axis=0
        )
        low = low + values[0]
        return np.stack([np.interp(time, every, column) for column in low.T], axis=1)

    def _noise(self, random: np.random.Generator, time: np.ndarray) -> np.ndarray:
        """Return AR(1) noise and a slow drift, (T, n) [N m]."""
        memory = np.exp(-2 * np.pi * self.colour / self.rate)
        white = random.normal(size=(time.size + 2000, N)) * np.sqrt(1 - memory**2)
        coloured = lfilter([1.0], [1.0, -memory], white, axis=0)[2000:]
        phase, period = random.uniform(0, 2 * np.pi, N), random.uniform(40, 200, N)
        drift = np.sin(2 * np.pi * time[:, None] / period + phase)
        return self.noise * coloured + self.drift * drift


@dataclass(frozen=True)
class Recorded:
    """A recording; (T, n) each but for time."""

    time: np.ndarray  # (T,) [s]
    position: np.ndarray  # [rad]
    torque: np.ndarray  # [N m]
    velocity: np.ndarray  # [rad/s]
    heat: np.ndarray  # 0 cold to 1 warm
    clean: np.ndarray  # [N m], torque without noise


def in_band(values: np.ndarray, rate: float) -> np.ndarray:
    """Return the part of even samples below `BAND`, without phase."""
    sos = butter(4, BAND, fs=rate, output="sos")
    return sosfiltfilt(sos, values, axis=0, padlen=min(int(rate), len(values) - 1))


def _rounded(values: np.ndarray, step: float) -> np.ndarray:
    return np.round(values / step) * step if step else values
