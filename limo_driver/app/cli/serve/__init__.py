"""`limo serve`: estimate the torque of arms whose joint states are on the network."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import Annotated

import typer

from limo_driver.app.cli.serve.options import log_limits, retraining_of, settings_of, stores_of
from limo_driver.app.cli.serve.showing import status_printer, teller
from limo_driver.app.console.terminal import say
from limo_driver.network.options import ConfigFile, Connect, Listen, RosDomain  # noqa: TC001  # typer

OPEN = (
    "the network is open: whoever reaches it can read, and can publish under any key; `limo "
    "secure` and --config close it"
)


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
        float, typer.Option(help="By which estimates are late [s]; less hears more noise.")
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
        typer.Option(
            metavar="KEY", help="Public key (PEM); versions that none of these signed are refused."
        ),
    ] = None,
    sign: Annotated[
        Path | None,
        typer.Option(help="Private key (PEM), with which challengers are signed that are trained."),
    ] = None,
    fifo: Annotated[
        bool,
        typer.Option("--fifo", help="Ask for SCHED_FIFO and locked memory."),
    ] = False,
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this time [s]; else at Ctrl-C.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print events and status as JSON, one a line.")
    ] = False,
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

    Examples:
        limo serve --arm iiwa14 --store models/ --log logs/
        limo serve --arm iiwa14 --model model/ --connect tcp/192.168.1.2:7447
        limo serve --arm iiwa14 --model model/ --ros joint_states \
            --connect tcp/127.0.0.1:7447
        limo serve --arm left=models/left --arm right=models/right
    """
    from limo_driver.app.library.live.serving import serve
    from limo_driver.app.library.live.supervising import listens, serve_apart
    from limo_driver.network.ros import RosTopic

    stores = stores_of(arm, store)
    limits = log_limits(log_size, log_age, len(stores))
    retraining = retraining_of(stores, log, retrain, retrain_every, training_seconds, challenger)
    apart = len(stores) > 1 and not listens(listen or (), config)
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
        connect=connect or (),
        listen=listen or (),
        config=config,
        fifo=fifo,
        told=teller(several=len(stores) > 1, as_json=as_json),
        show=status_printer(as_json=as_json),
    ) as service:
        if config is None:
            say(OPEN, stderr=True)
        service.wait(duration)
    for why in service.lost_logs.values():
        say(f"log: ends before the service did: {why}", stderr=True)
