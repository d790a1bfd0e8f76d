"""limo does not grow: lines, files, long files and words of its private dialect have ceilings.

`ceilings.yaml` has them. Whoever deletes lowers them: `python tests/test_ceilings.py --lower`;
`python tests/test_ceilings.py` prints lines and files by package, and each count with its ceiling.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
FILE = Path(__file__).with_name("ceilings.yaml")
CEILINGS = yaml.safe_load(FILE.read_text("utf-8"))
PACKAGES = ("limo_driver", "backends", "estimators", "limopa")
BESIDE = ("tests", "benchmarks", "examples", "docs")
PAGES = (".js", ".html", ".css", ".c", ".h", ".j2")  # of the packages, as far as limo's own
LONG = 400  # lines of a file, comments and all
HUNDREDS = 100  # in which lines are counted: a test that is mended need not find one to delete

_DOCSTRING = re.compile(r'^ *[rR]?"""(?:(?!""").)*""" *(?:#.*)?$', re.MULTILINE | re.DOTALL)
_WORD = re.compile(rf"(?<![A-Za-z])(?:{'|'.join(CEILINGS['words'])})(?![A-Za-z])")
_COMMENT = ("#", "//", "/*", "*", "<!--")


def lines_of(source: str, suffix: str = ".py") -> int:
    """Return the lines of code: docstrings, comments and blank lines are none."""
    code = _DOCSTRING.sub("", source) if suffix == ".py" else source
    comment = _COMMENT[:1] if suffix == ".py" else _COMMENT[1:]
    return sum(
        bool(line.strip()) and not line.strip().startswith(comment) for line in code.split("\n")
    )


@cache
def sources(folder: str, *suffixes: str) -> dict[Path, str]:
    """Return the texts of a folder's files, without what is of others or made."""
    files = (file for file in sorted((ROOT / folder).rglob("*")) if file.suffix in suffixes)
    return {f: f.read_text("utf-8") for f in files if not {"vendor", "out"} & {*f.parts}}


def of_packages(*suffixes: str) -> dict[Path, str]:
    """Return the texts of the four packages."""
    return {f: text for package in PACKAGES for f, text in sources(package, *suffixes).items()}


def size(texts: dict[Path, str]) -> tuple[int, int]:
    """Return lines of code, and files."""
    return sum(lines_of(text, file.suffix) for file, text in texts.items()), len(texts)


@cache
def counts() -> dict[str, dict[str, int]]:
    """Return everything that has a ceiling."""
    parts = {"packages": of_packages(".py"), "pages and C": of_packages(*PAGES)}
    parts |= {folder: sources(folder, ".py") for folder in BESIDE}
    product = (parts["packages"] | parts["pages and C"]).values()
    found = Counter(word for text in product for word in _WORD.findall(text))
    return {
        "lines": {name: size(texts)[0] for name, texts in parts.items()},
        "files": {name: size(texts)[1] for name, texts in parts.items()},
        f"files longer than {LONG} lines": {name: len(long(t)) for name, t in parts.items()},
        "words": {word: found[word] for word in CEILINGS["words"]},
    }


def long(texts: dict[Path, str]) -> list[str]:
    """Return the files that are too long to be read in one go."""
    return [str(file.relative_to(ROOT)) for file, text in texts.items() if text.count("\n") > LONG]


@pytest.mark.parametrize("kind", CEILINGS)
def test_nothing_is_above_its_ceiling(kind):
    now, above = counts()[kind], []
    for name, ceiling in CEILINGS[kind].items():
        if now[name] > ceiling:
            above.append(f"{name}: {now[name]}, the ceiling is {ceiling}")
    assert not above, (
        f"{kind}: {'; '.join(above)}. Deleting is the work: take away as much as was added, in the "
        f"same place. Long files: {long(of_packages('.py'))}"
    )


def test_what_is_counted():
    code = '"""Of a module,\nof two lines."""\n\nx = 1  # one\n# two\ndef f():\n    """Do."""\n'
    assert lines_of(code) == 2
    assert lines_of('x = """a text\nof two lines"""\n') == 2
    assert lines_of("// a comment\nlet x = 1\n\n", ".js") == 1


def main() -> None:
    """Print the table, and with --lower write what is lower than its ceiling."""
    now = counts()
    write = "{:28} {:>7} {:>7}\n".format
    table = write("", "lines", "files")
    table += "".join(write(name, *size(sources(name, ".py"))) for name in PACKAGES)
    for kind, values in now.items():
        table += write(f"\n{kind}", "now", "ceiling")
        table += "".join(write(name, count, CEILINGS[kind][name]) for name, count in values.items())
    sys.stdout.write(table)
    if "--lower" in sys.argv[1:]:
        now["lines"] = {n: -(-lines // HUNDREDS) * HUNDREDS for n, lines in now["lines"].items()}
        low = {k: {n: min(c, CEILINGS[k][n]) for n, c in v.items()} for k, v in now.items()}
        head = "".join(re.findall(r"^#.*\n", FILE.read_text("utf-8"), re.MULTILINE))
        FILE.write_text(head + yaml.safe_dump(low, sort_keys=False), "utf-8")


if __name__ == "__main__":
    main()
