"""`limo serve`: estimate the torque of arms whose joint states are on the network."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.command_line import (
    MappingOption,
    RosDomain,
    SessionOptions,
    describe_options,
    is_on_command_line,
)
from limo_driver.app.console.terminal import say, terminal
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from estimators.service.settings import ServiceSettings
    from limo_driver.logs.mcap_log import LogLimits
    from limo_driver.network.messages import Event

OPEN = (
    "the network is open: whoever reaches it can read, and can publish under any key; `limo "
    "secure` and --zenoh-config close it"
)
_BYTES_PER_GB = 1e9
_SECONDS_PER_DAY = 86400.0
_PART_UNDER_WAY = 0.1  # of all files of a log together, in the one that is being written


@describe_options
def command(
    context: typer.Context,
    *,
    arm: Annotated[list[str], typer.Option(metavar="NAME[=STORE]")],
    store: Path | None = None,
    model: Path | None = None,
    sim: Path | None = None,
    log: Path | None = None,
    log_size: Annotated[float, typer.Option(metavar="GB")] = 20.0,
    log_age: Annotated[float, typer.Option(metavar="DAYS")] = 30.0,
    network: SessionOptions,
    ros: Annotated[str | None, typer.Option(metavar="TOPIC")] = None,
    ros_domain: RosDomain = 0,
    rate: float | None = None,
    delay: float = 0.1,
    bound: float | None = None,
    contact: Annotated[str, typer.Option(metavar="N_M")] = "4",
    contact_for: Annotated[str, typer.Option(metavar="SECONDS")] = "0.15",
    free: Annotated[list[Path] | None, typer.Option(metavar="RECORDING")] = None,
    mapping: MappingOption = None,
    false_alarms: Annotated[float, typer.Option(metavar="PER_HOUR")] = 1.0,
    retrain: Annotated[bool | None, typer.Option("--retrain/--no-retrain")] = None,
    retrain_every: Annotated[float | None, typer.Option(metavar="HOURS")] = None,
    training_seconds: float = 300.0,
    challenger: Annotated[str, typer.Option(metavar="KIND")] = "same",
    trust: Annotated[list[Path] | None, typer.Option(metavar="KEY")] = None,
    sign: Path | None = None,
    fifo: bool = False,
    duration: Annotated[float | None, typer.Option(min=0.0)] = None,
    as_json: bool = False,
) -> None:
    r"""Subscribe to joint states, and publish torque estimates, external torque and events.

    States come from `limo run --stream`, or with --ros from ROS 2. The answers are on Zenoh, where
    `limo watch` shows them: limo/NAME/torque/estimate, limo/NAME/torque/external, limo/NAME/event
    and limo/NAME/status/service; docs/streaming.md and docs/messages.md say what they hold. With
    --log they are also in MCAP files, which Foxglove opens and `limo convert` reads.

    Estimates are of `delay` before the state that they answer, with a standard deviation and the
    version of the model. Where a model fails, the physics alone serves. Ctrl-C stops.

    Each of several arms has a process of its own, which is begun anew where it dies. Only with
    --listen, which one process alone can do, they share one, and its core.

    How far it is comes on standard output and on the network: loading, compiling (once on a
    machine), waiting for joint states, preparing, serving. `limo watch --until serving` waits
    for it. What else happens comes on standard error; with --json, everything on standard output.

    Args:
        arm: Name of the arm, as its driver publishes it, and its store if --store is not of it;
            give it several times to serve several arms.
        store: Model store, whose champion serves; see `limo models`.
        model: Model folder of `limo train`, instead of a store.
        sim: Physics that serves where no model does (sim.yaml).
        log: Folder for logs (MCAP) of states, estimates and events.
        log_size: All logs together; the oldest are deleted beyond it. inf for no limit.
        log_age: Logs that are older are deleted. inf for no limit.
        ros: Take joint states from this topic of ROS 2 (rmw_zenoh) instead of a driver.
        rate: Rate of the joint states [Hz]; measured if not given.
        delay: By which estimates are late [s]; less hears more noise.
        bound: Most that a learned part may add [N m]; else a tenth of the joint's limit.
        contact: External torque that is a contact [N m]; 8,8,6,6,4,2,1 says it joint by joint.
        contact_for: How long it has to last; also joint by joint.
        free: Log of motion that nothing touched: its errors say what a contact is, not --contact;
            takes --model.
        false_alarms: Of contact on the whole arm, with --free.
        retrain: Train a challenger from the logs where the arm has changed, and let it serve if it
            proves better; done where --store and --log are given.
        retrain_every: Also train after every so many hours.
        training_seconds: Seconds of the newest motion that a challenger learns from.
        challenger: Kind of the challengers: same as the champion, joint-physics, or a network, for
            example lstm-fcl.
        trust: Public key (PEM); versions that none of these signed are refused.
        sign: Private key (PEM), with which challengers are signed that are trained.
        fifo: Ask for SCHED_FIFO and locked memory.
        duration: Stop after this time [s]; else at Ctrl-C.
        as_json: Print events and status as JSON, one a line.

    Examples:
        limo serve --arm iiwa14 --store models/ --log logs/
        limo serve --arm iiwa14 --model model/ --connect tcp/192.168.1.2:7447
        limo serve --arm iiwa14 --model model/ --ros joint_states \
            --connect tcp/127.0.0.1:7447
        limo serve --arm left=models/left --arm right=models/right
    """
    from limo_driver.app.library.serving import serve
    from limo_driver.app.library.supervising import listens, serve_apart
    from limo_driver.network.ros import RosTopic

    if free:
        # What `--contact` would say for a rate of false alarms on free motion
        import numpy as np

        from limo_driver.app.cli.export import read_all
        from limo_driver.app.library.contacts import contact_thresholds

        if model is None:
            raise ConfigError("--free takes --model, whose errors on that motion it judges")
        if is_on_command_line(context, "contact"):
            raise ConfigError("--contact and --free both say what a contact is")
        calm = read_all(free, model, mapping)
        levels = contact_thresholds(model, calm, false_alarms=false_alarms, delay=delay)
        contact = ",".join(f"{level:.3g}" for level in levels)
        gaps = sum(int(np.sum(np.diff(own.time) > 1.5 / own.rate)) for own in calm)
        late = f", raised by {gaps} gaps in that motion, at which an arm jerks" * (gaps > 0)
        alarms = f"false alarms: {false_alarms:g} an hour"
        say(f"{alarms}: --contact {contact} [N m]{late}", stderr=True)
    stores = stores_of(arm, store)
    limits = log_limits(log_size, log_age, len(stores))
    # How to retrain, or None where it is not wanted or not possible
    from estimators.service.settings import RetrainingSettings

    possible = None not in stores.values() and log is not None
    if retrain and not possible:
        raise ConfigError("--retrain needs --store for the models and --log to learn from")
    if retrain_every is not None and (retrain is False or not possible):
        raise ConfigError("--retrain-every is for a service that retrains: give --store and --log")
    if challenger != "same":
        from estimators.service.retraining.trainer import check_kind

        check_kind(challenger)
    every = None if retrain_every is None else 3600.0 * retrain_every
    settings = RetrainingSettings(training_seconds, every, kind=challenger)
    retraining = settings if possible and retrain is not False else None
    apart = len(stores) > 1 and not listens(network.listen or (), network.config)
    with (serve_apart if apart else serve)(
        stores,
        model=model,
        simulation=sim,
        settings=settings_of(rate, delay, bound, contact, contact_for),
        log=log,
        log_limits=limits,
        retraining=retraining,
        trust=tuple(trust or ()),
        sign=sign,
        ros=None if ros is None else RosTopic(ros, ros_domain),
        connect=network.ends[0],
        listen=network.ends[1],
        config=network.config,
        fifo=fifo,
        told=teller(several=len(stores) > 1, as_json=as_json),
        show=status_printer(as_json=as_json),
    ) as service:
        if network.config is None:
            say(OPEN, stderr=True)
        service.wait(duration)
    for why in service.lost_logs.values():
        say(f"log: ends before the service did: {why}", stderr=True)


def settings_of(
    rate: float | None, delay: float, bound: float | None, contact: str, contact_for: str
) -> ServiceSettings:
    """Return how estimates are made and judged.

    Raises:
        ConfigError: A value is not above 0, or no such list.
    """
    from estimators.service.settings import ServiceSettings

    return ServiceSettings(
        rate=rate,
        delay=delay,
        bound=bound,
        contact_torque=per_joint("--contact", contact, "N m"),
        contact_duration=per_joint("--contact-for", contact_for, "s"),
    )


def per_joint(option: str, text: str, unit: str) -> tuple[float, ...]:
    """Return one number, or one for each joint of every arm.

    Raises:
        ConfigError: It is no such list, or not above 0 and finite.
    """
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"{option} is {text!r}, expected numbers with commas between") from None
    if not all(0 < value < math.inf for value in values):
        raise ConfigError(f"{option} is {text} {unit}, expected above 0 and finite")
    return values


def log_limits(size: float, age: float, arms: int) -> LogLimits:
    """Return the limits of each arm's log, whose share of the size is that of the others.

    Raises:
        ConfigError: A limit is not above 0.
    """
    from limo_driver.logs.mcap_log import LogLimits

    for option, value, unit in (("--log-size", size, "GB"), ("--log-age", age, "days")):
        if not value > 0:
            raise ConfigError(f"{option} is {value:g} {unit}, expected above 0")
    total = size * _BYTES_PER_GB / arms
    # what is under way is never deleted, so that it has to be a small part
    one = min(LogLimits.file_bytes, _PART_UNDER_WAY * total)
    return LogLimits(file_bytes=one, total_bytes=total, total_seconds=age * _SECONDS_PER_DAY)


def stores_of(given: list[str], store: Path | None) -> dict[str, Path | None]:
    """Return the store of each arm by name, None where none is given.

    Raises:
        ConfigError: An arm is named twice, or has two stores.
    """
    stores: dict[str, Path | None] = {}
    for entry in given:
        name, _, own = entry.partition("=")
        if name in stores:
            raise ConfigError(f"--arm {name} is given twice")
        if own and store is not None:
            raise ConfigError(f"--arm {entry} names a store, and so does --store {store}")
        stores[name] = Path(own) if own else store
    return stores


def teller(*, several: bool, as_json: bool) -> Callable[[str, Event], None]:
    """Return what shows an event to whoever watches the service, with the arm if it has several.

    For people, how far the service is comes on standard output, everything else on standard error.
    """
    import json

    console = terminal(stderr=not as_json)

    def tell(arm: str, event: Event) -> None:
        if as_json:
            line = {"event": event.kind, "time_ns": event.stamp_ns, "text": event.text}
            line |= {"arm": arm} if several else {}
            typer.echo(json.dumps({**line, **event.facts}))
            return
        style = {10: "dim", 20: "", 30: "yellow", 40: "red", 50: "bold red"}[event.level]
        line = f"{f'{arm}: ' if several else ''}{event.kind}: {event.text}"
        if "phase" in event.facts:
            with suppress(OSError):  # who reads that may have gone, for example once it serves
                say(line)
            return
        console.print(line, style=style)

    return tell


def status_printer(*, as_json: bool) -> Callable[[dict[str, object]], None]:
    """Return what shows the status of an arm, where it is asked for as JSON."""
    import json

    def show(status: dict[str, object]) -> None:
        if as_json:
            typer.echo(json.dumps({"status": status}))

    return show
