"""`limo demo`: a first report, from data that the command makes itself."""

from __future__ import annotations

from pathlib import Path

from limo_driver.app.console.arguments import describe_options
from limo_driver.app.console.terminal import progress_bar, terminal
from limo_driver.runtime.outputs import require_place


@describe_options
def command(
    *,
    out: Path,
) -> None:
    """Conceal a payload and hysteresis in a simulated arm, and see whether they are found.

    Takes a minute or two. Needs no data: it plans motion, records it on a simulated KUKA iiwa 14 in
    which something is concealed, and diagnoses the recording with a simulation that knows nothing
    of it. Writes report.html, and all that the report came from: believed.yaml, true.yaml,
    run.parquet, verdict.json and sim.yaml.

    Args:
        out: Folder for recording, simulations and report.

    Examples:
        limo demo --out demo
        limo diagnose demo/run.parquet --sim demo/believed.yaml --out again
    """
    from estimators.diagnosis.from_torque.pipeline import FILES as FOUND
    from limo_driver.app.library.demonstrating import FILES, demonstrate

    require_place(out, "the demonstration", (*FILES, *FOUND), [])
    with progress_bar(terminal(stderr=True, soft_wrap=True)) as tell:
        shown = demonstrate(tell)
        shown.save(out)
    console = terminal()
    for line in str(shown).splitlines():
        console.print(line)
    console.print(f"open {out / 'report.html'}")
