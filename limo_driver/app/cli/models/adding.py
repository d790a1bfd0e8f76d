"""`limo models add`: a model folder becomes a version."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import Annotated

import typer

from limo_driver.app.cli.models.options import (
    MODELS,
    JsonOption,
    RobotOption,
    StoreOption,
    opened,
    print_found,
)
from limo_driver.app.console.options import MappingOption  # noqa: TC001  # typer reads it


def add(
    folder: Annotated[Path, typer.Argument(help="Model folder of `limo train`.")],
    golden: Annotated[
        Path, typer.Option(help="Recording, whose liveliest seconds are kept with the answer.")
    ],
    test: Annotated[
        Path | None, typer.Option(help="Recording not trained on, for the errors to keep.")
    ] = None,
    parent: Annotated[int | None, typer.Option(help="Version that this one came from.")] = None,
    delay: Annotated[float, typer.Option(help="Delay of the live estimate [s].")] = 0.1,
    store: StoreOption = MODELS,
    robot: RobotOption = None,
    mapping: MappingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Add a model folder to a store as its next version.

    It is loaded, copied, and answers to some seconds of motion, which are kept: whoever loads it
    later sees whether it still answers the same.

    Example:
        limo models add model/ --golden run.parquet --test test.parquet
    """
    from estimators.service.comparison.comparison import metrics
    from limo_driver.app.library.reading import read

    motion = read(golden, mapping=mapping)
    record = {} if test is None else {"metrics": metrics(folder, read(test, mapping=mapping))}
    models = opened(store, robot)
    version = models.add(folder, golden=motion, parent=parent, record=record, delay=delay)
    print_found(dict(version.record), f"{version.path}: version {version.number}", as_json=as_json)
