"""What every function of the library takes alike: a value, or the file or folder that holds it.

A recording may be a `Recording` or the path of one; where several are taken, one alone, or any
iterable of either. A simulation may be a `Simulation` or the path of its `sim.yaml`, a model a
fitted one or its folder, a robot a `RobotModel`, a built-in name or the path of a URDF.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from limo_driver.errors import ConfigError
from limo_driver.logs.readers.proposals.recorded_joints import with_places
from limo_driver.model import BUILT_IN, RobotModel
from limo_driver.model.descriptions.description import split_reference
from limo_driver.physics import Simulation
from limo_driver.recordings.checks import is_named
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from estimators.residual_model import ResidualModel

_T = TypeVar("_T")
AUTO: Final = "auto"  # the model that motion held out speaks for
_READ: Final = "`limo.read(log, robot)` makes one of arrays by name, a DataFrame or any log"


def model_of(robot: RobotModel | Path | str) -> RobotModel:
    """Return a robot, or the one of this built-in name or URDF.

    Raises:
        ConfigError: There is no such robot, or it is none.
    """
    if isinstance(robot, (Path, str)):
        return RobotModel.load(robot)
    return expected(
        "robot", robot, RobotModel, "a RobotModel, a built-in name or the path of a URDF"
    )


def model_for(robot: RobotModel | Path | str, recordings: Sequence[Recording]) -> RobotModel:
    """Return a robot with the joints that recordings are of, where these are some of all.

    Its other joints are locked where the first recording that says so has them.

    Raises:
        ConfigError: There is no such robot, or it is none.
    """
    model = model_of(robot)
    chosen = [(each, split_reference(each.robot)[1]) for each in recordings]
    own = [
        (each, parts)
        for each, parts in chosen
        if parts and is_named(model, each.robot, each.source)
    ]
    is_chosen = any("=" not in part for part in model.chosen)
    of_part = (parts for each, parts in own if each.n != model.n)
    if not is_chosen and (parts := next(of_part, None)):
        return model.with_joints(parts)
    return with_places(model, own[0][1]) if own else model


def simulation_of(simulation: Simulation | Path | str) -> Simulation:
    """Return a simulation, or the one in this file.

    Raises:
        ConfigError: The file cannot be read, or it is no simulation.
    """
    if isinstance(simulation, (Path, str)):
        if str(simulation) in BUILT_IN:
            raise ConfigError(
                f"`simulation` is the robot {str(simulation)!r}, expected a Simulation or the path "
                f"of a sim.yaml; `limo.nominal({str(simulation)!r})` is the one of that robot"
            )
        return Simulation.load(simulation)
    return expected("simulation", simulation, Simulation, "a Simulation or the path of a sim.yaml")


def recording_of(recording: Recording | Path | str, name: str = "recording") -> Recording:
    """Return a recording, or the one in this file.

    Args:
        recording: Either.
        name: Of the argument.

    Raises:
        ConfigError: It is none; several are told apart by what they are.
        RecordingError: The file cannot be used.
    """
    if isinstance(recording, (Path, str)):
        return Recording.load(recording)
    return expected(name, recording, Recording, f"one Recording or the path of one; {_READ}")


def recordings_of(
    recordings: Recording | Path | str | Iterable[Recording | Path | str],
) -> tuple[Recording, ...]:
    """Return one or several recordings, each given itself or by its file.

    Raises:
        ConfigError: Something is no recording.
        RecordingError: A file cannot be used.
    """
    if isinstance(recordings, (Recording, Path, str)):
        return (recording_of(recordings),)
    wanted = f"a Recording, the path of one, or an iterable of these; {_READ}"
    columns = getattr(recordings, "items", None)
    if columns is not None and any(hasattr(values, "__len__") for _, values in columns()):
        raise unexpected("recordings", recordings, wanted)  # arrays by name, or a DataFrame
    try:
        given: tuple[Any, ...] = tuple(recordings)
    except TypeError:
        raise unexpected("recordings", recordings, wanted) from None
    for item in given:
        if not isinstance(item, (Recording, Path, str)):
            raise unexpected("recordings", item, wanted, "holds")
    return tuple(map(recording_of, given))


def trained_of(model: ResidualModel[Any] | Path | str) -> ResidualModel[Any]:
    """Return a fitted model, or the one in this folder.

    Raises:
        ConfigError: It is no model.
        ModelStoreError: The folder is incomplete or does not fit together.
    """
    if isinstance(model, (Path, str)):
        from estimators.model_folder import load_model

        return load_model(model)
    if not hasattr(model, "estimate"):
        raise unexpected("model", model, "a fitted model or the path of its folder")
    return model


def estimator_of(
    model: ResidualModel[Any] | Simulation | Path | str,
) -> tuple[ResidualModel[Any] | Simulation, Simulation]:
    """Return a fitted model or a simulation, given itself or by its path, and the simulation.

    Raises:
        ConfigError: It is neither.
        ModelStoreError: The folder is incomplete or does not fit together.
    """
    if isinstance(model, (Path, str)) and not Path(model).is_dir():
        model = simulation_of(model)
    if isinstance(model, Simulation):
        return model, model
    trained = trained_of(model)
    return trained, trained.simulation


def expected(name: str, value: object, kind: type[_T], wanted: str = "") -> _T:
    """Return a value that is of a kind.

    Args:
        name: Of the argument.
        value: That was given.
        kind: That it has to be of.
        wanted: What else would have done, in words.

    Raises:
        ConfigError: It is of another kind.
    """
    if not isinstance(value, kind):
        raise unexpected(name, value, wanted or f"a {kind.__name__}")
    return value


def unexpected(name: str, value: object, wanted: str, has: str = "is") -> ConfigError:
    """Return the error of an argument of the wrong type."""
    kind = type(value).__name__
    article = "an" if kind[:1].lower() in "aeiou" else "a"
    given = "None" if value is None else f"{article} {kind}"
    return ConfigError(f"`{name}` {has} {given}, expected {wanted}")


def require_model(name: str) -> type[ResidualModel[Any]] | None:
    """Return the estimator of a name that `train` takes; None for a network of limo's own.

    Args:
        name: As for `train`.

    Raises:
        ConfigError: There is none, or it is trained in another way.
        PlugInError: It is of another distribution and cannot be used.
    """
    from estimators.neural import NETWORKS
    from estimators.residual_model import known_estimators, to_train, trained_by_name
    from limo_driver.runtime.plugins import ESTIMATORS, plug_in

    plug_in(ESTIMATORS, name, NETWORKS)  # refuses one that takes the name of a network
    if name in NETWORKS:
        return None
    if name not in known_estimators():
        known = ", ".join((*trained_by_name(), *NETWORKS))
        raise ConfigError(f"no model is called {name!r}; known: {known}")
    return to_train(name)
