"""Serve arms on the network: states in, estimates out, models kept up to date."""

from __future__ import annotations

import gc
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from limo_driver.errors import ConfigError
from limo_driver.runtime.processes import uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence

    import zenoh

    from estimators.residual_model import ResidualModel
    from estimators.service.server import Service
    from estimators.service.settings import RetrainingSettings, ServiceSettings
    from estimators.service.store.served_models import ServedModels
    from limo_driver.logs.mcap_log import LogLimits
    from limo_driver.network.messages import Event
    from limo_driver.network.readiness import ServicePhase
    from limo_driver.network.ros import RosTopic
    from limo_driver.physics import Simulation
    from limo_driver.robot.realtime import RealtimeThreads
    from limo_driver.runtime.compilation import Compilation

COMPILING = "compiling what the first estimate needs, or reading it from the cache"


@contextmanager
def serve(
    arms: Mapping[str, Path | str | None] | Sequence[str] | str,
    *,
    store: Path | str | None = None,
    model: ResidualModel[Any] | Path | str | None = None,
    simulation: Simulation | Path | str | None = None,
    settings: ServiceSettings | None = None,
    log: Path | str | None = None,
    log_limits: LogLimits | None = None,
    retraining: RetrainingSettings | None = None,
    trust: Sequence[Path | str] | Path | str = (),
    sign: Path | str | None = None,
    ros: RosTopic | None = None,
    connect: Sequence[str] | str = (),
    listen: Sequence[str] | str = (),
    config: Path | str | None = None,
    fifo: bool = False,
    told: Callable[[str, Event], None] | None = None,
    show: Callable[[dict[str, Any]], None] | None = None,
) -> Generator[Service]:
    """Answer joint states of arms with estimates of their torque, until the block ends.

    Args:
        arms: Names, as their drivers publish them; a mapping gives each a store of its own.
        store: Of the models of every arm that has none of its own; its champion serves.
        model: Serves instead of a store; a folder or a fitted model.
        simulation: Serves where no model does, or its file; a model brings its own.
        settings: How estimates are made and judged; the usual ones if not given.
        log: Folder for logs (MCAP) of states, estimates and events.
        log_limits: Of each arm's log; none if not given.
        retraining: Train challengers from the logs as this says; needs stores and `log`.
        trust: Public key or keys (PEM); versions that none of these signed are refused.
        sign: Private key (PEM), with which challengers are signed that are trained.
        ros: Take the joint states of the one arm from this topic of ROS 2.
        connect: Endpoint or endpoints to reach, for example `tcp/192.168.1.2:7447`.
        listen: Endpoint or endpoints to be reached at.
        config: Zenoh's own configuration file (JSON5).
        fifo: Ask for SCHED_FIFO and locked memory; an event `fifo` says what is not permitted.
        told: Told the arm and the event of all that happens; a new phase is one, with `phase`
            among its facts. From any thread.
        show: Told the status of each arm once a second, and when its phase changes.

    Yields:
        The running service: `phases`, `wait` for Ctrl-C or a time, `stop`.

    Raises:
        ConfigError: The options contradict each other, an arm is served already, or the network
            cannot be used so.
        ModelStoreError: A store has no version that can be read, or a folder does not fit together.

    Example:
        >>> with limo.serve("iiwa14", model="model/") as service:
        ...     service.wait(60.0)
    """
    from limo_driver.network.readiness import ServicePhase
    from limo_driver.network.streaming import Presence
    from limo_driver.runtime import compilation

    trusted = tuple(map(Path, [trust] if isinstance(trust, (Path, str)) else trust))
    key = None if sign is None else Path(sign)
    stores = checked_stores(arms, store, model, simulation, log, retraining, ros, config)
    _check_signing(trusted, key, model)
    bulletins = Bulletins(list(stores), told or (lambda _arm, _event: None))
    bulletins.enter(ServicePhase.LOADING, "loading models and physics")
    with ExitStack() as open_:
        with uninterrupted():
            presence = open_.enter_context(
                Presence(list(stores), "service", connect, listen, config, joined=bulletins.join)
            )
        # While links come about, what the first estimates need is imported and loaded; nearly all
        # of that stays, so that looking for garbage in it would only take time.
        collecting = gc.isenabled()
        gc.disable()
        open_.callback(gc.enable if collecting else gc.disable)
        from estimators.service.arm_server import ArmServer
        from estimators.service.opening import rehearse
        from estimators.service.server import Service, as_before
        from estimators.service.settings import ServiceSettings
        from limo_driver.app.library.inputs import expected
        from limo_driver.logs.mcap_log import McapLog

        chosen = expected("settings", settings or ServiceSettings(), ServiceSettings)
        with compilation.report_to(bulletins.tell_compiled):  # loading compiles, too
            served = {
                name: _models(own, model, simulation, trusted, key) for name, own in stores.items()
            }
            _check_contacts(chosen, served)
            _check_bounds(chosen, served)
            presence.check()  # rather than after the rehearsal
            bulletins.enter(ServicePhase.COMPILING, COMPILING)
            for models in served.values():
                rehearse(models, chosen)
        session = presence.session()
        servers: list[ArmServer] = []
        logs: dict[str, McapLog] = {}
        open_.enter_context(as_before())
        with uninterrupted():
            for name, models in served.items():
                if log is not None:
                    logs[name] = open_.enter_context(McapLog(log, name, log_limits))
                arm = ArmServer(session, bulletins.of[name], models, chosen, logs.get(name), ros)
                open_.callback(arm.close)
                servers.append(arm)
                if retraining is not None and log is not None:
                    _keep(arm, Path(log), retraining)
            service = open_.enter_context(Service(servers, show or (lambda _status: None), logs))
        if collecting:
            gc.enable()
        if fifo:
            open_.enter_context(_in_real_time(bulletins))
        yield service


class Bulletins:
    """What a service tells of all its arms, from before it is on the network.

    Args:
        arms: Their names.
        told: Told the arm and the event of all that happens.
    """

    def __init__(self, arms: Sequence[str], told: Callable[[str, Event], None]) -> None:
        from functools import partial

        from estimators.service.inference.inbox import Bulletin
        from limo_driver.network.streaming import Keys

        self.of = {arm: Bulletin(Keys(arm), partial(told, arm)) for arm in arms}
        self._state = ""

    def join(self, session: zenoh.Session) -> None:
        """Publish from now on, and what was told before."""
        for bulletin in self.of.values():
            bulletin.join(session)

    def enter(self, phase: ServicePhase, text: str, state: str = "") -> None:
        """Tell how far the service of every arm is."""
        self._state = state
        for bulletin in self.of.values():
            bulletin.enter(phase, text, state=state)

    def warn(self, kind: str, text: str) -> None:
        """Tell what is of all arms, once."""
        from limo_driver.network.messages import Level

        next(iter(self.of.values())).event(kind, text, Level.WARN)

    def tell_compiled(self, how_far: Compilation) -> None:
        """Let the status say how much is compiled."""
        from limo_driver.network.readiness import ServicePhase

        state = f"compiling, {how_far.done} of at most {how_far.most} functions done"
        if state != self._state:
            self.enter(ServicePhase.COMPILING, COMPILING, state)


def _in_real_time(bulletins: Bulletins) -> RealtimeThreads:
    """Put all threads of this process under SCHED_FIFO, or say why not."""
    from limo_driver.robot.realtime import RealtimeThreads

    threads = RealtimeThreads()
    for refused in threads.refused:
        bulletins.warn("fifo", refused)
    return threads


def checked_stores(
    arms: Mapping[str, Path | str | None] | Sequence[str] | str,
    store: Path | str | None = None,
    model: object = None,
    simulation: object = None,
    log: Path | str | None = None,
    retraining: RetrainingSettings | None = None,
    ros: RosTopic | None = None,
    config: Path | str | None = None,
) -> dict[str, Path | None]:
    """Return the store of each arm by name, None where one model serves instead; see `serve`.

    Raises:
        ConfigError: An arm has no store, or two, or cannot be called so; the options contradict
            each other, or the network lets nothing of ROS 2 pass.
    """
    from collections.abc import Mapping

    from limo_driver.network.streaming import Keys

    if model is not None and simulation is not None:
        raise ConfigError("`model` brings its own simulation; `simulation` is for `store`")
    names = [arms] if isinstance(arms, str) else list(arms)
    given = arms if isinstance(arms, Mapping) else dict.fromkeys(names)
    stores: dict[str, Path | None] = {}
    for name in names:
        Keys(name)  # refuses what cannot be part of a key
        own = given[name] or store
        if (own is None) == (model is None):
            raise ConfigError(
                "give each of `arms` a store, or all one `store`, or `model`: one of them"
            )
        stores[name] = None if own is None else Path(own)
    if not stores:
        raise ConfigError("no arm is named, expected one or more")
    _check_ros(ros, config, len(stores))
    if retraining is not None:
        _check_retraining(stores, log, retraining)
    return stores


def _check_ros(ros: RosTopic | None, config: Path | str | None, arms: int) -> None:
    """Check that a topic of ROS 2 is of one arm, and that the network lets it pass."""
    if ros is None:
        return
    if config is not None:
        from limo_driver.network.config import require_passage

        require_passage(Path(config), ros.key_of_any_hash, "ingress", "`ros`")
    if arms > 1:
        raise ConfigError(f"`ros` is the topic of one arm, and {arms} are to be served")


def _check_signing(trust: Sequence[Path], sign: Path | None, model: object) -> None:
    """Check before anything is opened that keys can be used, and that they are for something."""
    if model is not None and (trust or sign is not None):
        raise ConfigError("`trust` and `sign` are for the versions of a `store`")
    if sign is not None:
        from estimators.service.store.aliases import check_signing

        check_signing(sign, trust)


def _check_retraining(
    stores: Mapping[str, Path | None], log: Path | str | None, settings: RetrainingSettings
) -> None:
    """Check that there is what to learn from, and a store for each arm.

    In one store, one arm would let the other's models serve.
    """
    if log is None or None in stores.values():
        raise ConfigError("`retraining` needs `store` for the models and `log` to learn from")
    arms: dict[Path, str] = {}
    for name, store in stores.items():
        assert store is not None  # noqa: S101  # see above
        other = arms.setdefault(store.resolve(), name)
        if other != name:
            raise ConfigError(
                f"arms {other} and {name} share the store {store}, which has one champion: give "
                "each a store of its own, or do without `retraining`"
            )
    if settings.kind != "same":
        from estimators.service.retraining.trainer import check_kind

        check_kind(settings.kind)


def _models(
    store: Path | None,
    model: ResidualModel[Any] | Path | str | None,
    simulation: Simulation | Path | str | None,
    trust: Sequence[Path],
    sign: Path | None,
) -> ServedModels:
    """Load the physics of an arm, and with it what serves."""
    from estimators.service.store.served_models import OneFolder, StoreModels
    from estimators.service.store.store import ModelStore
    from limo_driver.app.library.inputs import simulation_of

    if model is not None:
        is_path = isinstance(model, (Path, str))
        return OneFolder.open(Path(model)) if is_path else OneFolder("model", model)
    assert store is not None  # noqa: S101  # `_stores` refuses neither of the two
    known = None if simulation is None else simulation_of(simulation)
    robot = None if known is None else known.model.name
    models = StoreModels(ModelStore(store, robot, tuple(trust), sign), known)
    _ = models.physics  # refuses an empty store
    return models


def _check_contacts(settings: ServiceSettings, served: Mapping[str, ServedModels]) -> None:
    """Refuse what a contact is to be, where it is said of another number of joints."""
    import numpy as np

    said = {
        "contact_torque": settings.contact_torque,
        "contact_duration": settings.contact_duration,
    }
    for name_of, values in said.items():
        size = np.size(values)
        for name, models in served.items():
            n = models.physics.model.n
            if size not in {1, n}:
                raise ConfigError(
                    f"`{name_of}` has {size} values, expected one, or one for each of the {n} "
                    f"joints of {name}"
                )


def _check_bounds(settings: ServiceSettings, served: Mapping[str, ServedModels]) -> None:
    """Refuse an arm that states no torque limit, where that is what bounds its models."""
    for name, models in served.items():
        try:
            settings.bounds(models.physics.model.limits)
        except ConfigError as error:
            raise ConfigError(f"{name}: {error}") from None


def _keep(arm: Any, log: Path, settings: RetrainingSettings) -> None:  # noqa: ANN401  # ArmServer
    from estimators.service.retraining.retraining import Keeper

    arm.keeper = Keeper(arm, arm.models.store, log, settings)
    arm.keeper.start()
