"""`limo reproduce`: tables of published work, computed again."""

import typer

from limo_driver.app.cli.reproduce import table1

command = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@command.callback()
def reproduce() -> None:
    """Compute tables of published work again, on data of your own.

    Example:
        limo reproduce table1 --quick
    """


command.command(name="table1")(table1.command)
