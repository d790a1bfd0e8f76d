"""Pages of the site that are made, not written: front page, reference, gallery, notebooks, sample.

`mkdocs` calls `on_files` once and `on_page_markdown` for each page. What the examples printed and
drew comes from `out/gallery`, which `python docs/site/gallery.py` fills, that of notebooks from
`out/notebooks` (`python docs/site/notebooks.py`); without them the site has their texts alone, and
says so.
"""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path
from textwrap import dedent, indent
from typing import TYPE_CHECKING, Any

from mkdocs.structure.files import File

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
RAN = ROOT / "out" / "gallery"
FIGURES = ROOT / "benchmarks" / "results"  # what benchmarks printed
NOTEBOOKS = ROOT / "out" / "notebooks"
PACKAGES = {  # whose exported names the reference has
    "limo_driver": "The library: `import limo_driver as limo`",
    "limo_driver.physics": "Effects and simulations",
    "limopa": "Motion planning",
    "estimators": "Estimators",
    "estimators.rigid_body": "Identification of the rigid body",
    "estimators.diagnosis": "Diagnosis",
    "estimators.service": "The service",
    "backends.mujoco_sim": "The simulated robot",
    "backends.fri": "iiwa over FRI",
    "backends.can": "Arms on a CAN bus",
}
# The search of pages that are opened as files; npm package iframe-worker 1.0.4, MIT.
_WORKER = "assets/javascripts/iframe_worker.js"
_FETCHED = "https://unpkg.com/iframe-worker/shim"
_LINK = re.compile(r"\]\((?!https?:|#)([^)\s]+)\)")
_AT_HOME = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made."""
    made: dict[str, str | bytes] = {
        target: (ROOT / source).read_text(encoding="utf-8") for source, target in _AT_HOME.items()
    }
    made |= {"api.md": reference(), "gallery.md": gallery(), "sample.md": sample()}
    for source in sorted((HERE.parent / "notebooks").glob("*.py")):
        made[f"notebooks/{source.stem}.md"] = notebook(source)
    for path in sorted(NOTEBOOKS.glob("*/*")):
        if path.suffix in {".png", ".ipynb"}:
            made[f"notebooks/{path.name}"] = path.read_bytes()
    for path in sorted(RAN.glob("*/*")):
        if path.suffix in {".png", ".html"}:
            made[f"gallery/{path.parent.name}/{path.name}"] = path.read_bytes()
    for path in sorted(FIGURES.glob("*.txt")):
        made[f"figures/{path.name}"] = path.read_bytes()
    made[_WORKER] = (HERE / "iframe_worker.js").read_bytes()
    for name, content in made.items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to files of the project to where the site has them; others become plain text."""
    del config
    at = page.file.src_uri
    return _LINK.sub(lambda match: f"]({_here(match[1], at, files)})", markdown)


def on_post_template(output_content: str, template_name: str, config: MkDocsConfig) -> str:
    """Do the same in pages that are no documents, such as that of a dead address."""
    del template_name, config
    return output_content.replace(_FETCHED, _WORKER)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Take the one script that the theme would fetch from the site itself."""
    del page, config
    return output.replace(_FETCHED, _WORKER)


def _here(link: str, page: str, files: Files) -> str:
    path, mark, anchor = link.partition("#")
    path = path.removeprefix("../").removeprefix("./")
    if page in _AT_HOME.values():
        path = path.removeprefix("docs/")
    path = _AT_HOME.get(path, path)
    if path.startswith("notebooks/"):
        return path.replace(".py", ".md") + mark + anchor
    if path.startswith("benchmarks/results/"):
        return f"figures/{Path(path).name}"
    if path.startswith("examples/"):
        return f"gallery.md#{Path(path).name.replace('.', '')}"
    if not files.get_file_from_path(path) and (ROOT / path).exists():
        return "contributing.md"  # a file of the sources, which is told of there
    return path + mark + anchor


def reference() -> str:
    """Return the exported names of each package, by what they are."""
    parts = [
        "# Functions and values",
        "Every name that a package exports. Shapes: T samples, n joints; SI units throughout.",
    ]
    for package, title in PACKAGES.items():
        module = import_module(package)
        parts.append(f"## {title}\n\n`{package}`: {(module.__doc__ or '').strip().splitlines()[0]}")
        names = sorted(module.__all__, key=lambda name: (name[0].isupper(), name))
        parts += [_entry(package, name, getattr(module, name)) for name in names]
    return "\n\n".join(parts)


def _entry(package: str, name: str, value: Any) -> str:  # noqa: ANN401  # whatever is exported
    home = getattr(value, "__module__", None)
    if home is None or not hasattr(value, "__qualname__"):
        return f"### `{name}` {{ #{package}.{name} }}\n\nA value: `{value!r:.200}`."
    return f"::: {home}.{value.__qualname__}"


def notebook(source: Path) -> str:
    """Return the page of a notebook, with what it printed and drew if it was run."""
    page = NOTEBOOKS / source.stem / "page.md"
    if page.exists():
        return page.read_text(encoding="utf-8")
    title, text = source.stem.capitalize(), source.read_text(encoding="utf-8")
    return f"# {title}, in a notebook\n\n*Not run for this site.*\n\n```python\n{text}```\n"


def gallery() -> str:
    """Return each example: what it is for, what it drew and printed, and its text, folded."""
    parts = [
        "# Gallery",
        "Each example runs as it stands: `python examples/NAME.py`. What it printed and drew is "
        "from the run that made this site; examples that were not run for it come last.",
    ]
    programs = [path for path in sorted((ROOT / "examples").glob("*.py")) if _runs(path)]
    for path in sorted(programs, key=lambda path: not (RAN / path.stem).exists()):
        text = path.read_text(encoding="utf-8")
        first, *rest = told(ast.get_docstring(ast.parse(text)) or "")
        out = RAN / path.stem
        parts += [f"## {path.name} {{ #{path.name.replace('.', '')} }}", first, *rest]
        parts += [f"![{first}](gallery/{path.stem}/{p.name})" for p in sorted(out.glob("*.png"))]
        printed = out / "printed.txt"
        ran = printed.read_text(encoding="utf-8").rstrip() if printed.exists() else ""
        parts.append(f"```text\n{ran}\n```" if ran else "*Not run for this site.*")
        if (out / "report.html").exists():
            parts.append(f"[Its report](gallery/{path.stem}/report.html)")
        parts.append(_folded(path, "python"))
    for path in sorted((ROOT / "examples").glob("*.yaml")):
        parts += [f"## {path.name} {{ #{path.name.replace('.', '')} }}", _folded(path, "yaml")]
    return "\n\n".join(parts)


def told(said: str) -> list[str]:
    """Return the paragraphs of a docstring, with those that are indented as commands."""
    return [
        f"```sh\n{dedent(part)}\n```" if part.startswith("    ") else part
        for part in re.split(r"\n\n+", said)
    ]


def _runs(path: Path) -> bool:
    """Say whether a file of the examples does something, not only defines what others use."""
    defines = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef, ast.Assign, ast.AnnAssign)
    body = ast.parse(path.read_text(encoding="utf-8")).body[1:]
    return any(
        not isinstance(part, defines) and not ast.unparse(part).startswith("if TYPE_CHECKING")
        for part in body
    )


def _folded(path: Path, language: str) -> str:
    """Return a file, to be opened by a click."""
    fence = f"```{language}\n{path.read_text(encoding='utf-8').rstrip()}\n```"
    return f'??? example "{path.name}"\n\n{indent(fence, "    ")}'


def sample() -> str:
    """Return the page that leads to a report."""
    report = "gallery/diagnose_simulated/report.html"
    if not (RAN / "diagnose_simulated" / "report.html").exists():
        return "# Sample report\n\nThis site was made without running the examples."
    return (
        "# Sample report\n\nA simulated iiwa 14 carried 0.8 kg and had presliding hysteresis in "
        "joint 4; the diagnosis was told of neither. [Open its report]("
        + report
        + "): one file, which "
        "needs no network. [The script that made it](gallery.md#diagnose_simulatedpy)."
    )
