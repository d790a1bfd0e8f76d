"""The site: every page is reached, every exported name is told of, and nothing is fetched."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
import yaml
from audit import violations
from browser import browser, program

ROOT = Path(__file__).parents[2]


class _Reader(yaml.SafeLoader):
    """Reads `mkdocs.yml`, whatever tags it has."""


def _named(entries):
    for entry in entries:
        for value in entry.values():
            if isinstance(value, list):
                yield from _named(value)
            else:
                yield value


def test_every_document_is_in_the_navigation():
    site = yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), _Reader)  # noqa: S506
    named = set(_named(site["nav"]))
    assert {path.name for path in (ROOT / "docs").glob("*.md")} <= named
    assert len(named) == len(list(_named(site["nav"])))
    assert site["theme"]["font"] is False


def build(folder, at=ROOT):
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=at, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocstrings", reason="the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("site")
    done = build(folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.slow("builds the site")
def test_every_exported_name_is_told_of(site):
    hooks = (ROOT / "docs" / "site" / "hooks.py").read_text(encoding="utf-8")
    packages = re.findall(r'^    "([a-z_.]+)": "', hooks.split("PACKAGES = {")[1], re.MULTILINE)
    text = (site / "api.html").read_text(encoding="utf-8")
    anchors = set(re.findall(r'id="([\w.]+)"', text))
    assert "limo_driver" in packages
    for package in packages:
        module = import_module(package)
        for name in module.__all__:
            value = getattr(module, name)
            home = getattr(value, "__module__", package)
            known = f"{home}.{getattr(value, '__qualname__', name)}"
            assert {known, f"{package}.{name}"} & anchors, known


@pytest.mark.slow("builds the site")
def test_nothing_is_fetched_from_elsewhere(site):
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r'(?:src=|<link[^>]*href=)"https?://[^"]*"', text), page


@pytest.mark.slow("builds the site, and starts a browser")
@pytest.mark.skipif(program() is None, reason="no Chromium is installed on this machine")
@pytest.mark.parametrize(
    "name", ["index.html", "start.html", "sample.html", "notebooks/train.html"]
)
def test_everybody_can_use_it(site, name):
    """What the theme has of its own is held to WCAG, not to more."""
    with browser() as tab:
        found = violations(
            tab, (site / name).as_uri(), 1400, dark=False, ready="document.body.dataset.named",
            tags=("wcag2a", "wcag2aa"),
        )  # fmt: skip
    assert found == []


@pytest.mark.slow("builds the site")
@pytest.mark.parametrize("spoilt", ["[there](nowhere.md)", "[there](glossary.md#nothing)"])
def test_a_dead_link_fails_the_build(spoilt, tmp_path):
    pytest.importorskip("mkdocstrings", reason="the extra `docs` is not installed")
    (tmp_path / "docs").mkdir()
    for name in ("glossary.md", "start.md"):
        shutil.copy(ROOT / "docs" / name, tmp_path / "docs" / name)
    (tmp_path / "docs" / "start.md").write_text(f"# Start\n\n{spoilt}\n", encoding="utf-8")
    site = yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), _Reader)  # noqa: S506
    kept = {key: site[key] for key in ("site_name", "validation", "use_directory_urls")}
    nav = [{"Start": "start.md"}, {"Glossary": "glossary.md"}]
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(kept | {"nav": nav}), encoding="utf-8")
    done = build(tmp_path / "site", tmp_path)
    assert done.returncode != 0
    assert "there" in done.stderr or "nowhere" in done.stderr or "nothing" in done.stderr


def test_what_an_example_says_keeps_its_commands_apart_from_its_text():
    hooks = _hooks()
    said = "What it does.\n\n    python it.py  # now\n\nWhy, in two\nlines."
    assert hooks.told(said) == [
        "What it does.", "```sh\npython it.py  # now\n```", "Why, in two\nlines.",
    ]  # fmt: skip


def test_the_gallery_begins_with_what_ran_and_has_programs_alone(tmp_path, monkeypatch):
    hooks = _hooks()
    (tmp_path / "predict_torque").mkdir()
    (tmp_path / "predict_torque" / "printed.txt").write_text("largest torque\n")
    monkeypatch.setattr(hooks, "RAN", tmp_path)
    names = re.findall(r"^## (\S+)", hooks.gallery(), re.MULTILINE)
    assert names[0] == "predict_torque.py"
    assert {"can_arm.py", "creep_and_reverse.py", "your_csv.py"} <= set(names)
    assert "demo_page.py" not in names  # which only defines what the demo uses


def _hooks():
    pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
    place = ROOT / "docs" / "site" / "hooks.py"
    spec = spec_from_file_location("site_hooks", place)
    assert spec
    assert spec.loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
