"""`limo models`: versions of models in a store or a running service, and which of them serves."""

import typer

from limo_driver.app.cli.models import adding, checking, comparing, listing, promoting, retraining

command = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@command.callback()
def models() -> None:
    """Keep versions of models, compare them, and say which one serves.

    A store is a folder; a version in it never changes. The champion is the version that serves.
    With --arm, a running service is asked.

    Examples:
        limo models add model/ --golden run.parquet
        limo models promote 1 --reason "the first"
        limo models compare champion 2 --data test.parquet
        limo models list --arm iiwa14
    """


command.command(name="list")(listing.list_versions)
command.command(name="show")(listing.show)
command.command(name="add")(adding.add)
command.command(name="load")(promoting.load)
command.command(name="promote")(promoting.promote)
command.command(name="rollback")(promoting.rollback)
command.command(name="retrain")(retraining.retrain)
command.command(name="compare")(comparing.compare)
command.command(name="verify")(checking.verify)
command.command(name="sign")(checking.sign)
