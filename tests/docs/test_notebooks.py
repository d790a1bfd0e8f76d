"""The notebooks run as they are, draw a figure each, and become pages of the site."""

from __future__ import annotations

import base64
import os
from pathlib import Path
from types import SimpleNamespace

import notebooks
import pytest

SOURCES = sorted(notebooks.SOURCES.glob("*.py"))
PNG = b"\x89PNG"


def cell(kind, source, *outputs):
    return SimpleNamespace(cell_type=kind, source=source, outputs=outputs)


class Output(dict):
    __getattr__ = dict.__getitem__


def test_a_page_has_texts_code_prints_tables_and_pictures(tmp_path):
    shown = Output(output_type="display_data", data={"image/png": base64.b64encode(PNG).decode()})
    printed = Output(output_type="stream", name="stdout", text="3.0\n")
    warned = Output(output_type="stream", name="stderr", text="compiling\n")
    table = Output(output_type="execute_result", data={"text/html": "<table></table>"})
    value = Output(output_type="execute_result", data={"text/plain": "<one>"})
    cells = [
        cell("markdown", "# Title"),
        cell("code", "run()", printed, warned, shown, table, value),
    ]
    text = notebooks.page(SimpleNamespace(cells=cells), "one", tmp_path)
    assert text.startswith("# Title\n\n```python\nrun()\n```\n\n```text\n3.0\n```\n\n")
    assert "![Figure of one](one-1-2.png)" in text
    assert (tmp_path / "one-1-2.png").read_bytes() == PNG
    assert "<table></table>" in text
    assert "```text\n<one>\n```" in text
    assert "compiling" not in text
    assert "(one.ipynb)" in text


def test_what_ran_is_not_run_again_until_it_changes(tmp_path, monkeypatch):
    monkeypatch.setattr(notebooks, "OUT", tmp_path / "out")
    source = tmp_path / "one.py"
    source.write_text("# %%\n")
    assert not notebooks.ran(source)
    (tmp_path / "out" / "one").mkdir(parents=True)
    page = tmp_path / "out" / "one" / "page.md"
    page.write_text("")
    os.utime(page, (2.0, 2.0))
    for written, again in ((1.0, False), (3.0, True)):
        os.utime(source, (written, written))
        assert notebooks.ran(source) is not again


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_each_is_in_the_navigation(source):
    site = (Path(__file__).parents[2] / "mkdocs.yml").read_text(encoding="utf-8")
    assert f"notebooks/{source.stem}.md" in site
