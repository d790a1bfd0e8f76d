"""What touches an arm: its wrench in a recording, and from which torque on it is a contact."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limo_driver.app.library.inputs import estimator_of, recording_of, recordings_of
from limo_driver.app.library.learning import predict
from limo_driver.errors import RecordingError
from limo_driver.model.kinematics import ExternalWrench, FlangeWrench
from limo_driver.physics import Simulation
from limo_driver.recordings.bandwidth import bandwidth_for

if TYPE_CHECKING:
    from collections.abc import Iterable

    from estimators.residual_model import ResidualModel
    from limo_driver.recordings.recording import Recording


def external_wrench(
    model: ResidualModel[Any] | Simulation | Path | str,
    recording: Recording | Path | str,
    *,
    frame: str = "",
    in_base: bool = False,
    untouched: tuple[float, float] | None = None,
) -> ExternalWrench:
    """Find the wrench that something exerted on an arm while it was recorded.

    Measured and estimated torque go through the same filter; what is left is -Jᵀ F of the wrench F
    that explains it best, see `FlangeWrench`.

    Args:
        model: A simulation or a fitted model; or the path of a `sim.yaml`, or of a model's folder.
        recording: T samples of n joints with torque, or its file.
        frame: Link or site fixed to the last link, such as the tip of a tool; the flange if empty.
            Forces act at its origin, and have its axes, which turn with the arm.
        in_base: Tell them in the axes of the robot's base instead, at the same point.
        untouched: From and to which of the recording's times [s] nothing touched the arm: what is
            left there in the mean is taken off everywhere, as the bias of sensors and loads that
            the model does not know. Where a model knows no errors, those there stand for them.

    Returns:
        Wrenches with standard deviations, and the external torques that they explain. The largest
        force is often that of a singular pose, where a small torque is a large force: look where
        `certainty` is largest.

    Raises:
        ConfigError: The last link has no such frame.
        RecordingError: No torque was recorded, of another arm, or less than two samples are
            untouched.
        NotFittedError: The model is not trained.

    Example:
        >>> found = limo.external_wrench("sim.yaml", "scan.parquet", untouched=(0.0, 2.0))
        >>> print(found.value[found.certainty.argmax()])
    """
    recording = recording_of(recording)
    recording.check_torque()
    model, simulation = estimator_of(model)
    is_bare = isinstance(model, Simulation)
    width = bandwidth_for([recording], None, model.bandwidth) if is_bare else model.bandwidth
    recording.check_robot(simulation.model)
    if not recording.measured_joints.all():
        without = ", ".join(str(j + 1) for j in np.flatnonzero(~recording.measured_joints))
        raise RecordingError(f"no torque of joint {without}", path=recording.source or None)
    find = FlangeWrench(simulation.model, frame, in_base=in_base)
    estimate = predict(model, recording).filtered(recording, width)
    external = recording.filtered_torque(width) - estimate.torque
    bias, spread = np.zeros(external.shape[1]), np.full(external.shape[1], np.nan)
    if untouched is not None:
        time, (begin, end) = recording.time, untouched
        rows = (time >= begin) & (time <= end)
        if rows.sum() < 2:  # noqa: PLR2004
            raise RecordingError(
                f"{rows.sum()} samples are untouched, from {begin:g} to {end:g} s, expected two or "
                f"more; the recording is from {time[0]:g} to {time[-1]:g} s",
                path=recording.source or None,
            )
        bias, spread = external[rows].mean(axis=0), external[rows].std(axis=0)
    external = external - bias
    std = np.where(np.isnan(estimate.std), spread, estimate.std)
    found = [find.of(*row) for row in zip(recording.position, external, std, strict=True)]
    return ExternalWrench(
        find.frame,
        in_base,
        recording.time,
        np.array([wrench.value for wrench in found]),
        np.sqrt([np.diag(wrench.covariance) for wrench in found]),
        external,
        bias,
    )


def contact_thresholds(
    model: ResidualModel[Any] | Simulation | Path | str,
    free: Recording | Path | str | Iterable[Recording | Path | str],
    *,
    false_alarms: float = 1.0,
    delay: float = 0.1,
) -> tuple[float, ...]:
    """Return the external torque that error alone passes as seldom as wanted, by joint [N m].

    As `contact_torque` of `ServiceSettings`, for a service of the same model, rate and delay. One
    that asks a contact to last has fewer false alarms.

    Args:
        model: A simulation or a fitted model; or the path of a `sim.yaml`, or of a model's folder.
        free: Recording or recordings of motion like that of use, which nothing touched and nothing
            was fitted to.
        false_alarms: On the whole arm, that are bearable [1/h].
        delay: By which estimates are late [s].

    Raises:
        ConfigError: The rate of alarms is not possible, or the delay too short for the model.
        RecordingError: A recording has no torque, another arm or rate, or errors have too few
            peaks; says for how long to record.

    Example:
        >>> levels = limo.contact_thresholds("model/", "air.parquet", false_alarms=1.0)
        >>> settings = limo.ServiceSettings(contact_torque=levels)
    """
    from estimators.embedded.contact import measured_contact
    from estimators.stream import Stream

    recordings = recordings_of(free)
    known, simulation = estimator_of(model)
    stream = Stream(known, recordings[0].rate, delay)
    found = measured_contact(false_alarms, stream, simulation, recordings, in_torque=True)
    return tuple((found.level * found.error).tolist())
