"""`limo models compare`: two versions on one recording."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.cli.models.options import (
    MODELS,
    JsonOption,
    RobotOption,
    StoreOption,
    TrustOption,
    WhichArgument,
    opened,
    print_found,
)
from limo_driver.app.console.options import MappingOption  # noqa: TC001  # typer reads it

if TYPE_CHECKING:
    from rich.table import Table

    from estimators.service.comparison.gate import Comparison
    from estimators.service.store.version import Version


def compare(
    champion: WhichArgument,
    challenger: WhichArgument,
    data: Annotated[Path, typer.Option(help="Recording that neither was trained on.")],
    block: Annotated[
        float, typer.Option(help="Length of a block [s]; longer than errors remember.")
    ] = 5.0,
    out: Annotated[Path | None, typer.Option(help="Where to write a picture (PNG).")] = None,
    store: StoreOption = MODELS,
    robot: RobotOption = None,
    trust: TrustOption = None,
    mapping: MappingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare the errors of two versions joint by joint, with intervals.

    The intervals are of paired errors, averaged over blocks. The last line says whether the second
    version would be promoted over the first: better on average, and worse on no joint.

    Example:
        limo models compare champion 2 --data test.parquet --out difference.png
    """
    from estimators.service.comparison.comparison import compare_versions, difference_figure
    from limo_driver.app.library.reading import read
    from limo_driver.runtime.outputs import require_file, whole

    if out is not None:
        require_file(out, [data])
    models = opened(store, robot, trust)
    versions = models.open(champion), models.open(challenger)
    found = compare_versions(*versions, read(data, mapping=mapping), block)
    if out is not None:
        from estimators.pictures import png

        names = [f"version {version.number}" for version in versions]
        with whole(out) as draft:
            draft.write_bytes(png(difference_figure(found, versions[0].joints, names)))
    print_found(found.as_values(), _table(found, versions), as_json=as_json)


def _table(found: Comparison, versions: tuple[Version, Version]) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    first, second = (f"version {version.number}" for version in versions)
    table = Table(
        box=SIMPLE_HEAD,
        pad_edge=False,
        title=f"RMSE [N m] of {first} and {second}, {found.blocks} blocks",
        caption=("promote: " if found.promote else "do not promote: ") + found.reason,
    )
    table.add_column("joint", overflow="fold")
    for heading in (first, second, "difference", "95 % interval", "ratio\nof MSE"):
        table.add_column(heading, justify="right", no_wrap=True)
    for j, name in enumerate(versions[0].joints):
        table.add_row(
            name,
            f"{found.champion[j]:.4f}",
            f"{found.challenger[j]:.4f}",
            f"{found.difference.value[j]:+.4f}",
            f"{found.difference.low[j]:+.4f} to {found.difference.high[j]:+.4f}",
            f"{found.ratio.value[j]:.3g}",
        )
    return table
