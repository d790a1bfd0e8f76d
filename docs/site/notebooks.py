"""Run the notebooks of the site: each, with what it printed and drew, goes to out/notebooks/NAME/.

    python docs/site/notebooks.py

Their sources are scripts in jupytext's percent format (`docs/notebooks`). One that ran already and
has not changed since is not run again. Where one fails, so does this.
"""

from __future__ import annotations

import base64
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "docs" / "notebooks"
OUT = ROOT / "out" / "notebooks"
LONGEST = 600  # [s] that a cell may take before something hangs


def ran(source: Path) -> bool:
    """Say whether a notebook ran since it was written."""
    page = OUT / source.stem / "page.md"
    return page.exists() and page.stat().st_mtime > source.stat().st_mtime


def run(source: Path) -> None:
    """Execute a notebook in a folder of its own; write it, and the page of it.

    Raises:
        CellExecutionError: A cell fails.
        ValueError: No cell draws.
    """
    import jupytext
    import nbformat
    from jupyter_client.manager import AsyncKernelManager
    from jupyter_core.utils import run_sync
    from nbclient import NotebookClient

    notebook = jupytext.read(source)
    with TemporaryDirectory() as folder:
        socket = str(Path(folder) / "kernel")  # no port is opened
        manager = AsyncKernelManager(kernel_name="python3", transport="ipc", ip=socket)
        places = {"metadata": {"path": folder}}
        try:
            client = NotebookClient(notebook, km=manager, timeout=LONGEST, resources=places)
            client.execute(cleanup_kc=True)  # else its sockets are closed by whoever comes next
        finally:
            run_sync(manager.shutdown_kernel)(now=True)
    kept = OUT / source.stem
    shutil.rmtree(kept, ignore_errors=True)
    kept.mkdir(parents=True)
    nbformat.write(notebook, kept / f"{source.stem}.ipynb")
    text = page(notebook, source.stem, kept)
    if not list(kept.glob("*.png")):
        raise ValueError(f"{source}: draws nothing, expected a figure at least")
    (kept / "page.md").write_text(text, encoding="utf-8")


def page(notebook: Any, name: str, folder: Path) -> str:  # noqa: ANN401  # nbformat's
    """Return a notebook as Markdown; pictures go into a folder."""
    parts: list[str] = []
    for number, cell in enumerate(notebook.cells):
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for k, output in enumerate(cell.outputs):
            # pages of all notebooks lie in one folder of the site
            picture = folder / f"{name}-{number}-{k}.png"
            parts.append(_output(output, picture, f"Figure of {name}"))
    link = f"[This page as a notebook]({name}.ipynb), with all that it printed and drew."
    return "\n\n".join([*filter(None, parts), link]) + "\n"


def _output(output: Any, picture: Path, said: str) -> str:  # noqa: ANN401  # nbformat's
    if output.output_type == "stream":
        return f"```text\n{output.text.rstrip()}\n```" if output.name == "stdout" else ""
    data = output.get("data", {})
    if "image/png" in data:
        picture.write_bytes(base64.b64decode(data["image/png"]))
        return f"![{said}]({picture.name})"
    if "text/html" in data:
        return data["text/html"]
    text = data.get("text/plain", "")
    return f"```text\n{text}\n```" if text else ""


def main() -> None:
    """Run those that changed."""
    for source in sorted(SOURCES.glob("*.py")):
        if not ran(source):
            sys.stdout.write(f"running {source.relative_to(ROOT)}\n")
            run(source)


if __name__ == "__main__":
    main()
