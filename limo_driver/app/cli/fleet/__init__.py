"""`limo fleet`: many recordings of many arms."""

import typer

from limo_driver.app.cli.fleet import diagnosing

command = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@command.callback()
def fleet() -> None:
    """Diagnose the recordings of a fleet of arms, and compare the arms.

    Example:
        limo fleet diagnose "recordings/**/*.parquet" --sim sim.yaml --out fleet
    """


command.command(name="diagnose")(diagnosing.diagnose)
