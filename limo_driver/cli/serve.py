"""`limo serve`: estimate the torque of arms whose joint states are on the network."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.network_options import ConfigFile, Connect, Listen, RosDomain  # noqa: TC001  # typer

if TYPE_CHECKING:
    from collections.abc import Callable

    from estimators.service.arm_server import ArmServer
    from estimators.service.models import ServedModels
    from estimators.service.settings import RetrainingSettings
    from limo_driver.mcap_log import LogLimits, McapLog
    from limo_driver.messages import Event

_BYTES_PER_GB = 1e9
_SECONDS_PER_DAY = 86400.0
_PART_UNDER_WAY = 0.1  # of all files of a log together, in the one that is being written


def command(
    arm: Annotated[
        list[str],
        typer.Option(
            metavar="NAME[=STORE]",
            help="Name of the arm, as its driver publishes it, and its store if --store is not of "
            "it; give it several times to serve several arms.",
        ),
    ],
    store: Annotated[
        Path | None, typer.Option(help="Model store, whose champion serves; see `limo models`.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="Model folder of `limo train`, instead of a store.")
    ] = None,
    sim: Annotated[
        Path | None, typer.Option(help="Physics that serves where no model does (sim.yaml).")
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="Folder for logs (MCAP) of states, estimates and events.")
    ] = None,
    log_size: Annotated[
        float,
        typer.Option(
            metavar="GB",
            help="All logs together; the oldest are deleted beyond it. inf for no limit.",
        ),
    ] = 20.0,
    log_age: Annotated[
        float,
        typer.Option(metavar="DAYS", help="Logs that are older are deleted. inf for no limit."),
    ] = 30.0,
    connect: Connect = None,
    listen: Listen = None,
    config: ConfigFile = None,
    ros: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="Take joint states from this topic of ROS 2 (rmw_zenoh) instead of a driver.",
        ),
    ] = None,
    ros_domain: RosDomain = 0,
    rate: Annotated[
        float | None, typer.Option(help="Rate of the joint states [Hz]; measured if not given.")
    ] = None,
    delay: Annotated[
        float, typer.Option(help="By which estimates are late \\[s]; less hears more noise.")
    ] = 0.1,
    bound: Annotated[
        float | None,
        typer.Option(
            help="Most that a learned part may add [N m]; else a tenth of the joint's limit."
        ),
    ] = None,
    contact: Annotated[
        str,
        typer.Option(
            metavar="N_M",
            help="External torque that is a contact [N m]; 8,8,6,6,4,2,1 says it joint by joint.",
        ),
    ] = "4",
    contact_for: Annotated[
        str,
        typer.Option(metavar="SECONDS", help="How long it has to last; also joint by joint."),
    ] = "0.15",
    retrain: Annotated[
        bool | None,
        typer.Option(
            "--retrain/--no-retrain",
            help="Train a challenger from the logs where the arm has changed, and let it serve if "
            "it proves better; done where --store and --log are given.",
        ),
    ] = None,
    retrain_every: Annotated[
        float | None, typer.Option(metavar="HOURS", help="Also train after every so many hours.")
    ] = None,
    training_seconds: Annotated[
        float, typer.Option(help="Seconds of the newest motion that a challenger learns from.")
    ] = 300.0,
    challenger: Annotated[
        str,
        typer.Option(
            metavar="KIND",
            help="Kind of the challengers: same as the champion, joint-physics, or a network, for "
            "example lstm-fcl.",
        ),
    ] = "same",
    trust: Annotated[
        list[Path] | None,
        typer.Option(help="Public key (PEM); versions that none of these signed are refused."),
    ] = None,
    sign: Annotated[
        Path | None,
        typer.Option(help="Private key (PEM), with which challengers are signed that are trained."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this time \\[s]; else at Ctrl-C.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print events and status as JSON, one a line.")
    ] = False,
) -> None:
    """Subscribe to joint states, and publish torque estimates, external torque and events.

    Estimates are of `delay` before the state that they answer, with a standard deviation and the
    version of the model. Where a model fails, the physics alone serves. Ctrl-C stops.

    Arms share one Python process and one core: serve each from a process of its own unless they
    are slow.

    [bold]Examples[/bold]

        limo serve --arm iiwa14 --store models/ --log logs/

        limo serve --arm iiwa14 --model model/ --connect tcp/192.168.1.2:7447

        limo serve --arm iiwa14 --model model/ --ros joint_states --connect tcp/127.0.0.1:7447

        limo serve --arm left=models/left --arm right=models/right
    """
    from estimators.service.arm_server import ArmServer
    from estimators.service.server import serve
    from estimators.service.settings import ServiceSettings
    from limo_driver.errors import ConfigError
    from limo_driver.mcap_log import McapLog
    from limo_driver.ros import RosTopic
    from limo_driver.streaming import open_session

    topic = None if ros is None else RosTopic(ros, ros_domain)
    if topic is not None and config is not None:
        from limo_driver.network_config import require_passage

        require_passage(config, topic.key_of_any_hash, "ingress", "--ros")
    keys = _SigningKeys(tuple(trust or ()), sign)
    keys.check(model)
    arms = _arms(arm, store, model, sim, keys)
    settings = ServiceSettings(
        rate=rate,
        delay=delay,
        bound=bound,
        contact_torque=_per_joint("--contact", contact, "N m", arms),
        contact_duration=_per_joint("--contact-for", contact_for, "s", arms),
    )
    limits = _log_limits(log_size, log_age, len(arms))
    retraining = _retraining(arms, log, retrain, retrain_every, training_seconds, challenger)
    if topic is not None and len(arms) > 1:
        raise ConfigError(f"--ros is the topic of one arm, and {len(arms)} are to be served")
    with ExitStack() as open_:
        session = open_.enter_context(open_session(connect or (), listen or (), config))
        servers: list[ArmServer] = []
        for name, models in arms.items():
            kept = None if log is None else McapLog(log, name, limits)
            tell = _teller(name if len(arms) > 1 else None, as_json=as_json)
            if kept is not None:
                open_.callback(_close, kept)
            servers.append(ArmServer(session, name, models, settings, kept, tell, ros=topic))
            open_.callback(servers[-1].close)
            if retraining is not None:
                _keep(servers[-1], log, retraining)
        serve(servers, duration, _status_printer(as_json=as_json))


@dataclass(frozen=True)
class _SigningKeys:
    """Whose signatures count, and what challengers are signed with."""

    trusted: tuple[Path, ...]
    own: Path | None

    def check(self, model: Path | None) -> None:
        """Check them before anything is opened.

        Raises:
            ConfigError: They are for versions, and a model folder is served.
            ModelStoreError: A key cannot be used, or what is signed would not be trusted.
        """
        from limo_driver.errors import ConfigError

        if model is not None and (self.trusted or self.own is not None):
            raise ConfigError("--trust and --sign are for the versions of a --store")
        if self.own is not None:
            from estimators.service.signature import check_signing

            check_signing(self.own, self.trusted)


def _per_joint(
    option: str, text: str, unit: str, arms: dict[str, ServedModels]
) -> tuple[float, ...]:
    """Return one number, or one for each joint of every arm.

    Raises:
        ConfigError: It is no such list, or not above 0 and finite.
    """
    from limo_driver.errors import ConfigError

    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"{option} is {text!r}, expected numbers with commas between") from None
    if not all(0 < value < math.inf for value in values):
        raise ConfigError(f"{option} is {text} {unit}, expected above 0 and finite")
    for name, models in arms.items():
        n = models.physics.model.n
        if len(values) not in {1, n}:
            raise ConfigError(
                f"{option} has {len(values)} values, expected one, or one for each of the {n} "
                f"joints of {name}"
            )
    return values


def _log_limits(size: float, age: float, arms: int) -> LogLimits:
    """Return the limits of each arm's log, whose share of the size is that of the others.

    Raises:
        ConfigError: A limit is not above 0.
    """
    from limo_driver.errors import ConfigError
    from limo_driver.mcap_log import LogLimits

    for option, value, unit in (("--log-size", size, "GB"), ("--log-age", age, "days")):
        if not value > 0:
            raise ConfigError(f"{option} is {value:g} {unit}, expected above 0")
    total = size * _BYTES_PER_GB / arms
    # what is under way is never deleted, so that it has to be a small part
    one = min(LogLimits.file_bytes, _PART_UNDER_WAY * total)
    return LogLimits(file_bytes=one, total_bytes=total, total_seconds=age * _SECONDS_PER_DAY)


def _close(log: McapLog) -> None:
    """Finish a log, and say where its end could not be written."""
    log.close()
    if log.failure is not None:
        typer.echo(f"log: ends before the service did: {log.failure}", err=True)


def _arms(
    given: list[str],
    store: Path | None,
    model: Path | None,
    sim: Path | None,
    keys: _SigningKeys,
) -> dict[str, ServedModels]:
    """Return what serves each arm, by name.

    Raises:
        ConfigError: An arm is named twice, or has no store, or two.
    """
    from limo_driver.errors import ConfigError
    from limo_driver.streaming import Keys

    arms: dict[str, ServedModels] = {}
    for entry in given:
        name, _, own = entry.partition("=")
        Keys(name)  # refuses what cannot be part of a key
        if name in arms:
            raise ConfigError(f"--arm {name} is given twice")
        if own and store is not None:
            raise ConfigError(f"--arm {entry} names a store, and so does --store {store}")
        arms[name] = _models(Path(own) if own else store, model, sim, keys)
    return arms


def _models(
    store: Path | None, model: Path | None, sim: Path | None, keys: _SigningKeys
) -> ServedModels:
    from estimators.service.models import OneFolder, StoreModels
    from estimators.service.store import ModelStore
    from limo_driver.errors import ConfigError
    from limo_driver.physics import Simulation

    if (store is None) == (model is None):
        raise ConfigError("give --arm NAME=STORE, --store or --model, one of them")
    if model is not None:
        if sim is not None:
            raise ConfigError("--model brings its own simulation; --sim is for --store")
        return OneFolder.open(model)
    simulation = None if sim is None else Simulation.load(sim)
    robot = None if simulation is None else simulation.model.name
    versions = ModelStore(store or Path(), robot, keys.trusted, keys.own)
    models = StoreModels(versions, simulation)
    _ = models.physics  # refuses an empty store before anything is opened
    return models


def _retraining(
    arms: dict[str, ServedModels],
    log: Path | None,
    wanted: bool | None,
    hours: float | None,
    seconds: float,
    kind: str,
) -> RetrainingSettings | None:
    """Return how to retrain, or None where it is not wanted or not possible."""
    from estimators.service.models import StoreModels
    from estimators.service.settings import RetrainingSettings
    from limo_driver.errors import ConfigError

    stored = all(isinstance(models, StoreModels) for models in arms.values())
    possible = stored and log is not None
    if wanted and not possible:
        raise ConfigError("--retrain needs --store for the models and --log to learn from")
    if hours is not None and (wanted is False or not possible):
        raise ConfigError("--retrain-every is for a service that retrains: give --store and --log")
    if possible and wanted is not False:
        _refuse_shared_stores(arms)
    if kind != "same":
        from estimators.service.learning import check_kind

        check_kind(kind)
    every = None if hours is None else 3600.0 * hours
    settings = RetrainingSettings(seconds, every, kind=kind)
    return settings if possible and wanted is not False else None


def _refuse_shared_stores(arms: dict[str, ServedModels]) -> None:
    """Refuse to retrain two arms in one store, where one would let the other's models serve."""
    from estimators.service.models import StoreModels
    from limo_driver.errors import ConfigError

    homes: dict[Path, str] = {}
    for name, models in arms.items():
        assert isinstance(models, StoreModels)  # noqa: S101  # checked before
        home = models.store.home.resolve()
        if home in homes:
            raise ConfigError(
                f"arms {homes[home]} and {name} share the store {models.store.root}, which has one "
                "champion: give each a store of its own, or --no-retrain"
            )
        homes[home] = name


def _keep(server: ArmServer, log: Path | None, settings: RetrainingSettings) -> None:
    from estimators.service.keeper import Keeper
    from estimators.service.models import StoreModels

    assert isinstance(server.models, StoreModels)  # noqa: S101  # checked by `_retraining`
    assert log is not None  # noqa: S101
    server.keeper = Keeper(server, server.models.store, log, settings)
    server.keeper.start()


def _teller(arm: str | None, *, as_json: bool) -> Callable[[Event], None]:
    """Return what shows an event to whoever watches the service, with the arm if it has several."""
    import json

    from rich.console import Console

    console = Console(stderr=not as_json)

    def tell(event: Event) -> None:
        if as_json:
            line = {"event": event.kind, "time_ns": event.stamp_ns, "text": event.text}
            line |= {} if arm is None else {"arm": arm}
            typer.echo(json.dumps({**line, **event.facts}))
            return
        style = {10: "dim", 20: "", 30: "yellow", 40: "red", 50: "bold red"}[event.level]
        whose = "" if arm is None else f"{arm}: "
        console.print(
            f"{whose}{event.kind}: {event.text}", style=style, highlight=False, markup=False
        )

    return tell


def _status_printer(*, as_json: bool) -> Callable[[dict[str, object]], None]:
    import json

    def show(status: dict[str, object]) -> None:
        if as_json:
            typer.echo(json.dumps({"status": status}))

    return show
