"""`limo demo`: a first report, from data that the command makes itself."""

from __future__ import annotations

from pathlib import Path

import typer

from limo_driver.app.console.command_line import describe_options
from limo_driver.app.console.terminal import progress_bar, terminal
from limo_driver.errors import ConfigError, LimoError
from limo_driver.runtime.outputs import require_folder, require_place


@describe_options
def command(
    *,
    out: Path,
    whole: bool = False,
    backend: str | None = None,
) -> None:
    """Conceal a payload and hysteresis in a simulated arm, and see whether they are found.

    Takes a minute or two. Needs no data: it plans motion, records it on a simulated KUKA iiwa 14 in
    which something is concealed, and diagnoses the recording with a simulation that knows nothing
    of it. Writes report.html, and all that the report came from: believed.yaml, true.yaml,
    run.parquet, verdict.json and sim.yaml.

    With --whole, in about four minutes, all of limo instead: plan, run, stream to a service, push,
    pick up a load, retrain, swap, kill the service and start it again, diagnose its log, export.
    Writes index.html, with figure and bar of each step; the exit status is 1 where one is missed.

    Args:
        out: Folder for recording, simulations and report.
        whole: Go the whole way, with real processes.
        backend: With --whole: how the driver reaches the arm: mujoco, fri (to `limo controller`) or
            can (to `limo drives`); else mujoco.

    Examples:
        limo demo --out demo
        limo demo --out whole --whole
        limo demo --out over_fri --whole --backend fri
        limo diagnose demo/run.parquet --sim demo/believed.yaml --out again
    """
    if whole:
        _go_the_whole_way(out, backend or "mujoco")
        return
    if backend is not None:
        raise ConfigError("--backend says over what --whole goes; give both")
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


def _go_the_whole_way(out: Path, backend: str) -> None:
    """Do all of it, print each step and its bar, and write the page."""
    from limo_driver.app.library.whole.explaining import whole_page
    from limo_driver.app.library.whole.proving import prove

    if out.is_dir() and any(out.iterdir()):
        raise ConfigError(
            "is not empty: give a new folder, whose store has no versions yet", path=out
        )
    require_folder(out, "the whole")
    with progress_bar(terminal(stderr=True, soft_wrap=True)) as tell:
        proof = prove(out, backend, tell)
    whole_page(proof).save(out / "index.html")
    console = terminal()
    for step in proof.steps:  # a line each: as a table they are wider than a terminal
        held = "held" if step.held else "missed"
        line = f"{held:6}  {step.name}: {step.figure} (bar: {step.bar})"
        console.print(line)
    console.print(f"{proof.seconds:.0f} s; open {out / 'index.html'}")
    if proof.failure:
        raise LimoError(proof.failure)
    if not proof.held:
        raise typer.Exit(1)
