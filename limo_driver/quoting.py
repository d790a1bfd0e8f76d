"""Names are data: how a text of somebody else stands in each language that limo writes.

A joint may be called `*/ system("x"); /*`, a file `$(x)`, a column by what changes the colours of a
terminal. One function for each language says such a name so that nothing obeys it, and so that it
can be read back where the language can say it. Values for YAML and JSON are left to their dumpers,
literals of Python to `ascii`.
"""

from __future__ import annotations

import re
import shlex
from html import escape
from pathlib import PurePath
from typing import Final
from unicodedata import category

_SPACE: Final = "Zs"  # spaces of other widths, which units are kept together with
_ENDS_COMMENT: Final = re.compile(r"(?<=\*)/|(?<=/)\*|(?<=\?)\?")
_MARKS: Final = re.compile(r"[\\`*_{}\[\]<>#|]")
_NO_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_XML: Final = {'"': "&quot;", "&": "&amp;", "<": "&lt;", ">": "&gt;"}


def in_line(text: str) -> str:
    r"""Return a text as a message or a terminal shows it in one line: `\x1b` for an escape.

    What turns the direction of writing is shown likewise, and so is a line break.
    """
    return text if text.isprintable() else "".join(map(_shown, text))


def on_terminal(text: str) -> str:
    """Return a text of several lines as a terminal shows it, each as `in_line` does."""
    return text if text.isprintable() else "\n".join(map(in_line, text.split("\n")))


def in_html(text: str) -> str:
    """Return a text as it stands in HTML, between tags or in the quotes of an attribute."""
    return escape(on_terminal(text))


def in_xml(text: str) -> str:
    """Return a text as it stands in the quotes of an attribute of XML."""
    said = for_xml(text)
    return "".join(_XML.get(c) or (c if _shown(c) == c else f"&#x{ord(c):x};") for c in said)


def for_xml(text: str) -> str:
    """Return a text that a writer of XML can say; what XML cannot say at all is shown."""
    return _NO_XML.sub(lambda found: _shown(found[0]), text)


def in_c_comment(text: str) -> str:
    """Return a text as it stands in a comment of C, which neither ends there nor goes on."""
    shown = in_line(text).encode("ascii", "backslashreplace").decode()
    return _ENDS_COMMENT.sub(r"\\\g<0>", shown)


def in_c_string(text: str) -> str:
    """Return a text as a literal of C or C++, in quotes; of UTF-8, whatever the source is."""
    shown = (c if c.isascii() and (c.isalnum() or c in " _-.") else _octal(c) for c in text)
    return f'"{"".join(shown)}"'


def _octal(c: str) -> str:
    return "".join(f"\\{byte:03o}" for byte in c.encode("utf-8", "surrogateescape"))


def in_docstring(text: str) -> str:
    """Return a text as it stands in a docstring of Python, in triple quotes."""
    return ascii(text)[1:-1].replace('"', '\\"')


def in_markdown(text: str) -> str:
    """Return a text as it stands in a paragraph or a cell of Markdown."""
    return _MARKS.sub(lambda mark: f"\\{mark[0]}", in_line(text))


def in_shell(*words: object) -> str:
    """Return a command of the shell, each word as one argument whatever is in it.

    A path is none of its options, however it begins.
    """
    return " ".join(map(_word, words))


def _word(word: object) -> str:
    text = f"./{word}" if isinstance(word, PurePath) and str(word).startswith("-") else str(word)
    if text.isprintable():
        return shlex.quote(text)
    said = text.encode("utf-8", "surrogateescape")
    return "$'" + "".join(_in_ansi_c(byte) for byte in said) + "'"


def _in_ansi_c(byte: int) -> str:
    plain = chr(byte).isascii() and chr(byte).isprintable() and chr(byte) not in "\\'"
    return chr(byte) if plain else f"\\x{byte:02x}"


def _shown(c: str) -> str:
    if c.isprintable() or category(c) == _SPACE:
        return c
    return c.encode("unicode_escape").decode("ascii")
