"""`limo doctor`: why a link to a real arm does not work."""

from __future__ import annotations

from typing import Annotated

import typer

from limo_driver.app.console.arguments import describe_options
from limo_driver.app.console.terminal import say

command = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@command.callback()
def doctor() -> None:
    """Find out why a link to a real arm does not work, and what to do about it.

    Example:
        limo doctor fri
    """


@command.command()
@describe_options
def fri(
    *,
    host: str | None = None,
    port: int = 30200,
    seconds: Annotated[float, typer.Option(min=0.05, max=600.0)] = 5.0,
    as_json: bool = False,
) -> None:
    """Listen to the arm, answer it without commanding anything, and say how the link stands.

    To the robot it is a client like any other: where a session waits for one, the robot's own
    program may begin to move. Keep a hand on the stop.

    Exit status 0 if the link works; 3 if nobody sends, 4 if the robot falls silent, 5 if it does
    not hear the answers, 6 at a safety stop, 7 if drives are off, 8 if the send period is too long
    to command, and 1 for anything else that is wrong.

    Args:
        host: Address of the controller; else whoever sends.
        port: UDP port of this machine.
        seconds: How long to listen, and then to answer [s].
        as_json: Print what was found as JSON.

    Examples:
        limo doctor fri
        limo doctor fri --host 192.170.10.2 --port 30201 --seconds 10 --json
    """
    import json

    from backends.fri.doctor import examine

    found = examine(host, port, seconds)
    if as_json:
        typer.echo(json.dumps(found.as_json()))
    else:
        for finding in found.findings:
            say(f"{'problem' if finding.problem else 'note'}: {finding.text}")
        if found.healthy:
            typer.echo("the link works")
    raise typer.Exit(found.status)
