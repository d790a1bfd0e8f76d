"""`limo report`: two diagnoses side by side."""

from __future__ import annotations

from pathlib import Path

from limo_driver.app.console.command_line import describe_options
from limo_driver.app.console.terminal import terminal


@describe_options
def command(
    first: Path,
    second: Path,
    *,
    out: Path,
) -> None:
    """Put two diagnoses side by side: two days, before and after a repair, two units.

    Says which findings are new, gone or changed, where their 95 % intervals do not overlap, and
    the errors of each joint in both.

    Args:
        first: Folder of a diagnosis.
        second: Folder of another one, of the same kind of arm.
        out: The page to write (.html).

    Example:
        limo report monday/ tuesday/ --out comparison.html
    """
    from estimators.diagnosis.reading import verdict_in
    from estimators.diagnosis.report.truth import comparison
    from estimators.diagnosis.verdict import IMPROVED
    from limo_driver.physics import Simulation
    from limo_driver.runtime.outputs import require_page

    require_page(out)
    verdicts = [verdict_in(folder) for folder in (first, second)]
    model = Simulation.load(first / IMPROVED).model
    page = comparison(model, _names(first, second), verdicts)
    page.save(out)
    console = terminal()
    console.print(page.title)
    console.print(f"wrote {out}")


def _names(first: Path, second: Path) -> list[str]:
    """Return names of two folders, as short as tells them apart."""
    short = [first.resolve().name, second.resolve().name]
    return short if short[0] != short[1] else [str(first), str(second)]
