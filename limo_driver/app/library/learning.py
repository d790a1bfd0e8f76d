"""Models of an arm from its recordings: identified, learned, evaluated, and asked for torques."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, overload

from limo_driver.app.library import inputs
from limo_driver.errors import ConfigError
from limo_driver.physics import Simulation, Tolerances
from limo_driver.physics.described import described_effects
from limo_driver.physics.drives import described_drives
from limo_driver.recordings.bandwidth import bandwidth_for

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from estimators.base import Estimate
    from estimators.diagnosis.comparison import SimulationComparison
    from estimators.diagnosis.from_motion.fitting.identification import DriveIdentification
    from estimators.evaluation import Evaluation
    from estimators.hybrid.training.fit import Epoch
    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.residual_model import ResidualModel
    from estimators.rigid_body import Identification, JointTerms, Rows
    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording


_TRUSTED: Final = 0.05  # of inertias that a description states, where nobody says how well


def identify(
    robot: RobotModel | Path | str,
    recordings: Recording | Path | str | Iterable[Recording | Path | str],
    terms: JointTerms | None = None,
    rows: Rows | None = None,
    tolerance: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Identification:
    """Identify inertias and friction of a robot from recordings.

    Least squares finds the base parameters; a convex fit then finds physically consistent inertias
    that explain the same torques, and stays at the robot's description where the motion reveals
    nothing. Columns that are exchanged or have another sign or unit are refused, as by `diagnose`:
    base parameters would fit many of them well, and mean nothing. An arm that hangs on a wall or a
    ceiling although its description stands is identified as it hangs.

    Args:
        robot: The arm with its nominal inertias, or its built-in name or URDF.
        recordings: Measured motions and torques of that arm: one or several, or their files.
        terms: What is modelled beside inertias: friction, offset of the sensor, armature.
        rows: Which rows are used, how joints are weighed, and the bandwidth of the filter [Hz],
            which is found on motion held out if they are not given.
        tolerance: Relative standard deviation of the nominal inertias; by default the one under
            which the data are most likely.
        progress: Told the samples done since the last call.

    Returns:
        What was found; the model to go on with is its `simulation`. Its `warnings` begin with what
        makes one doubt the recordings.

    Raises:
        ConfigError: A tolerance outside 1e-4 to 10, or there is no such robot.
        RecordingError: A recording is of another robot or given twice, nothing moves, no torque was
            measured, columns are exchanged or have another sign or unit, or no row is left.

    Example:
        >>> limo.identify("iiwa14", "run.parquet").simulation.save("sim.yaml")
    """
    from estimators.base import check_recordings
    from estimators.diagnosis.from_torque.residuals.plausibility import (
        as_it_hangs,
        turned,
    )
    from estimators.rigid_body import JointTerms, Rows
    from estimators.rigid_body import identify as found
    from estimators.rigid_body.best_bandwidth import fitting_bandwidth

    measured = inputs.recordings_of(recordings)
    model = inputs.model_for(robot, measured)
    terms = inputs.expected("terms", terms or JointTerms(), JointTerms)
    if rows is not None:
        inputs.expected("rows", rows, Rows)
    check_recordings(measured, model)
    note: tuple[str, ...] = ()
    if rows is None:
        width, note = fitting_bandwidth(model, measured)
        rows = Rows(width)
    hung, doubts = as_it_hangs(model, measured, rows.bandwidth)
    result = found(hung, measured, terms, rows, tolerance, progress)
    simulation = result.simulation
    if rows.bandwidth != bandwidth_for(measured):
        simulation = replace(simulation, bandwidth=rows.bandwidth)
    warnings = (*turned(model, hung), *doubts, *result.warnings, *note)
    return replace(result, simulation=simulation, warnings=warnings)


def nominal(
    robot: RobotModel | Path | str,
    recordings: Recording | Path | str | Iterable[Recording | Path | str] = (),
    inertia_tolerance: float = _TRUSTED,
    gain_tolerance: float = 0.0,
) -> Simulation:
    """Return what is believed of a robot of which only a description is at hand.

    Inertias are those of the description. Friction, armature and offsets, which it seldom knows,
    are identified beside inertias that are free, so that a payload or a wrong link changes
    neither. Without recordings there is no friction in it, which a diagnosis takes for friction
    that is unknown, and identifies beside everything else: it needs no recordings here. Armature,
    springs and cogging are then those of the description, which a diagnosis may find wrong.

    Args:
        robot: A model, a built-in name, or the path of a URDF or MJCF.
        recordings: Measured motions and torques of that arm: none, one or several, or their files.
        inertia_tolerance: How far the inertias of the description may be off, relative, 1 sigma.
        gain_tolerance: How far the scale of each joint's torque may be, as of torques that are
            currents times a constant.

    Returns:
        A simulation to go on with; to give to `diagnose`, one without friction.

    Raises:
        ConfigError: There is no such robot.
        RecordingError: As for `identify`.

    Example:
        >>> found = limo.diagnose(limo.nominal("iiwa14"), "run.parquet")
    """
    measured = inputs.recordings_of(recordings)
    model = inputs.model_for(robot, measured)
    asked = {"inertia": inertia_tolerance != _TRUSTED, "gain": gain_tolerance != 0.0}
    own = frozenset(name for name, is_asked in asked.items() if is_asked)
    if not measured:
        known = Tolerances(inertia=inertia_tolerance, gain=gain_tolerance, stated=own)
        stated = tuple(effect for effect in described_effects(model) if not effect.is_friction)
        return Simulation(model.name, stated, tolerances=known)
    found = identify(model, measured).simulation
    own |= {"friction"}  # as the recordings tell it
    known = replace(found.tolerances, inertia=inertia_tolerance, gain=gain_tolerance, stated=own)
    return Simulation(model.name, found.effects, tolerances=known)


def identify_drives(
    robot: Simulation | RobotModel | Path | str,
    recordings: Recording | Path | str | Iterable[Recording | Path | str],
) -> DriveIdentification:
    """Identify drives and friction of an arm that tells commands and positions, and no torque.

    Args:
        robot: Its rigid body, whose weight gives the scale: a simulation, a model, a built-in name
            or the path of a description.
        recordings: With commands: one or several, or their files.

    Returns:
        A simulation that can be run forward, and how sure its values are. Its `warnings` say what
        makes one doubt the recordings.

    Raises:
        ConfigError: There is no such robot.
        RecordingError: A recording has no commands, is given twice, or its commands are no
            set-points in rad that came before the motion.
    """
    from estimators.diagnosis.from_motion import identify_drives as identified

    measured = inputs.recordings_of(recordings)
    known = robot if isinstance(robot, Simulation) else described(inputs.model_for(robot, measured))
    return identified(known, measured)


def described(robot: RobotModel, inertia_tolerance: float = _TRUSTED) -> Simulation:
    """Return a robot as its description states it: with friction, armature and drives.

    Args:
        robot: The model.
        inertia_tolerance: How far its inertias may be off, relative, 1 sigma.
    """
    own = frozenset[str]() if inertia_tolerance == _TRUSTED else frozenset({"inertia"})
    return Simulation(
        robot.name,
        described_effects(robot),
        tolerances=Tolerances(inertia=inertia_tolerance, stated=own),
        drives=described_drives(robot),
    )


def predict(
    model: ResidualModel[Any] | Simulation | Path | str,
    recording: Recording | Path | str,
    *,
    bandwidth: float | None = None,
    delay: float | None = None,
) -> Estimate:
    """Predict the noise-free torque of a recorded motion.

    Args:
        model: A simulation or a fitted model; or the path of a `sim.yaml`, or of a model's folder.
        recording: T samples of n joints, or its file; its torque is not looked at.
        bandwidth: Of the zero-phase differentiator [Hz]; 10, or what the recording can bear, if
            not given. A model has its own.
        delay: Predict what a live stream would have said this much later [s], from the past alone.

    Returns:
        Torque (T, n) [N m] and how sure it is; with a delay, a `LiveEstimate` with its own times.
        A simulation does not know its errors: `std` is NaN throughout, and nothing is flagged as
        outside of what was learned.

    Raises:
        ConfigError: A bandwidth is given to a model, or the delay is too short for it.
        ShapeError: The recording has another number of joints.
        RecordingError: The bandwidth is too high for the sampling rate.
        NotFittedError: The model is not trained.

    Example:
        >>> limo.predict("sim.yaml", "run.parquet").torque
    """
    from estimators.base import Estimate

    recording = inputs.recording_of(recording)
    if isinstance(model, (Path, str)) and not Path(model).is_dir():
        model = inputs.simulation_of(model)
    if isinstance(model, Simulation):
        width = bandwidth_for([recording], bandwidth, model.bandwidth)
        if delay is None:
            return Estimate.unsure(model.predict(recording, width))
        from estimators.residual_model import SimulationOnly

        return _live(SimulationOnly(model, width), recording, delay)
    if bandwidth is not None:
        raise ConfigError("a bandwidth is of a simulation; a model has the one it was trained with")
    trained = inputs.trained_of(model)
    return trained.estimate(recording) if delay is None else _live(trained, recording, delay)


def _live(model: Any, recording: Recording, delay: float) -> Estimate:  # noqa: ANN401  # LiveEstimator
    from estimators.stream import Stream

    stream = Stream(model, recording.rate, delay)
    return stream.advance(stream.init(), recording.time, recording.position)[0]


def load_model(folder: Path | str) -> ResidualModel[Any]:
    """Read the folder of a trained model; runs no code from it.

    Args:
        folder: As `save` of a model, or `limo train`, wrote it.

    Raises:
        ModelStoreError: The folder is incomplete or does not fit together, by name.

    Example:
        >>> limo.predict(limo.load_model("model/"), "run.parquet").std
    """
    from estimators.model_folder import load_model as loaded

    return loaded(folder)


@overload
def evaluate(
    model: ResidualModel[Any] | Path | str, recording: Recording | Path | str
) -> Evaluation: ...


@overload
def evaluate(
    model: Simulation | Path | str,
    recording: Recording | Path | str,
    *,
    against: Simulation | Path | str,
    estimate: str = ...,
    external: str = ...,
) -> SimulationComparison: ...


def evaluate(
    model: ResidualModel[Any] | Simulation | Path | str,
    recording: Recording | Path | str,
    *,
    against: Simulation | Path | str | None = None,
    estimate: str = "estimate",
    external: str = "external_torque",
) -> Evaluation | SimulationComparison:
    """Compare a model with the rigid body it adds to, or a simulation with another, on a recording.

    Args:
        model: A fitted model, or its folder; with `against`, a simulation, or its file.
        recording: Of the same arm, or its file; best one that nothing was fitted to.
        against: The simulation that `model` may be an improvement of.
        estimate: NAME of columns NAME_1 to NAME_n: the torque by a model of the arm's maker.
        external: Likewise of what that model leaves, so that the maker calls it external.

    Returns:
        Errors of each joint; of two simulations with the 95 % interval of the change, and why.

    Raises:
        ConfigError: A simulation is given without another to compare it with, or of another arm.
        NotFittedError, ModelStoreError: The model is not trained, or cannot take the sampling rate.
        RecordingError: It is of another robot, too short, or lacks columns that were named.

    Example:
        >>> limo.evaluate("model/", "test.parquet").save("evaluation/")
        >>> print(limo.evaluate("diagnosis/sim.yaml", "test.parquet", against="sim.yaml"))
    """
    if against is None:
        if isinstance(model, Simulation) or Path(str(model)).suffix in {".yaml", ".yml"}:
            raise ConfigError("`model` is a simulation, and `against` is missing, another one")
        from estimators.evaluation import evaluate as judged

        return judged(inputs.trained_of(model), inputs.recording_of(recording))
    from estimators.diagnosis.comparison import compare_simulations

    return compare_simulations(
        inputs.simulation_of(model),  # pyright: ignore[reportArgumentType]  # refuses others by name
        inputs.simulation_of(against),
        inputs.recording_of(recording),
        estimate=estimate,
        external=external,
    )


def train(
    simulation: Simulation | Path | str,
    recordings: Recording | Path | str | Iterable[Recording | Path | str],
    model: str = "joint-physics",
    *,
    bandwidth: float | None = None,
    settings: TrainingSettings | None = None,
    progress: Callable[[Epoch], None] | None = None,
    unfinished: Path | str | None = None,
) -> ResidualModel[Any]:
    """Learn the torque that a simulation leaves unexplained.

    Args:
        simulation: Normally an identified one, or its file.
        recordings: Of its robot: one or several, or their files.
        model: `joint-physics`, fitted in closed form with standard deviations; a network: mlp7,
            lstm-2, lstm-fcl, gru, lru, transformer; an estimator of another distribution; or
            `auto`, which compares a few on motion held out.
        bandwidth: Of the zero-phase filter on motion and torque [Hz]; if not given, that of
            `settings` or of the simulation, or else found on motion held out.
        settings: Of a network's training; the usual ones if not given. `model` is its name.
        progress: Told each epoch of a network's training.
        unfinished: Folder in which a network is kept epoch by epoch; the same training with it goes
            on after a kill, and gives the same.

    Returns:
        The fitted model; `save` writes its folder.

    Raises:
        ConfigError: There is no such model, or settings were given for one that has none.
        MissingPackageError: It is a network, and PyTorch is not installed.
        PlugInError: It is of another distribution and cannot be used.
        RecordingError: A recording is of another robot, or too short.
        DivergedError: The loss of a network is no longer finite.

    Example:
        >>> limo.train("sim.yaml", "run.parquet", "lstm-fcl").save("model/")
    """
    from estimators.rigid_body.best_bandwidth import fitting_bandwidth
    from estimators.studies.model_choice import best_model

    estimator = None if model == inputs.AUTO else inputs.require_model(model)
    simulation, measured = inputs.simulation_of(simulation), inputs.recordings_of(recordings)
    on_epoch: Callable[[Epoch], None] = progress or (lambda _epoch: None)
    if model == inputs.AUTO or estimator is not None:
        if settings is not None:
            raise ConfigError(f"settings are of networks; {model} has no such choice")
        width, _ = fitting_bandwidth(simulation, measured, bandwidth)
        if not width > 0:
            raise ConfigError(f"a bandwidth of {width:g} Hz, expected a positive number")
        if estimator is not None:
            return estimator.unfitted(simulation, width).fit(measured)
        return best_model(simulation, measured, width, on_epoch)
    from estimators.hybrid import HybridModel
    from estimators.hybrid.model import train as fitted
    from estimators.hybrid.training.settings import TrainingSettings

    known = inputs.expected("settings", settings or TrainingSettings(), TrainingSettings)
    chosen = replace(known, model=model)
    if bandwidth is not None or settings is None:
        most = chosen.rate or float("inf")
        width, _ = fitting_bandwidth(simulation, measured, bandwidth, most)
        chosen = replace(chosen, bandwidth=width)
    hybrid = HybridModel(simulation, chosen)
    kept = None if unfinished is None else Path(unfinished)
    hybrid.fitted_ = fitted(simulation, measured, chosen, on_epoch, kept)
    return hybrid
