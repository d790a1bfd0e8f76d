"""Help pages on a terminal of 80 columns: whole units, whole paragraphs, examples to copy."""

import re
import shlex
import textwrap
from itertools import pairwise

import pytest

from limo_driver.app.console.command_line import command_line, help_of

WIDTH = 80
UNIT = re.compile(r"\[[^\]]+\]")
EXAMPLES = re.compile(r"^  Examples?:\n((?:      .*\n)+)", flags=re.MULTILINE)


def commands():
    """Return every command by its words, `()` for limo itself."""
    found, waiting = {}, [((), command_line())]
    while waiting:
        words, command = waiting.pop()
        found[words] = command
        inner = getattr(command, "commands", {})
        waiting += [((*words, name), each) for name, each in inner.items()]
    return found


COMMANDS = commands()


@pytest.fixture(scope="module")
def pages():
    """Keep the help of each command that was asked for: several tests read it."""
    return {}


@pytest.fixture
def page(limo, monkeypatch, pages):
    """Make a function that returns the help of a command."""
    monkeypatch.setenv("COLUMNS", str(WIDTH))

    def of(words):
        if words not in pages:
            shown = limo(*words, "--help")
            assert shown.returncode == 0
            assert not shown.stderr
            pages[words] = shown.stdout
        return pages[words]

    return of


def examples(text):
    """Return the example commands of a page, each on one line."""
    found = EXAMPLES.search(text)
    assert found, "no examples"
    return textwrap.dedent(found[1]).replace("\\\n", "").splitlines()


every_command = pytest.mark.parametrize("words", sorted(COMMANDS), ids=" ".join)


@every_command
def test_a_page_fits_and_holds_nothing_but_text(page, words):
    text = page(words)
    assert max(map(len, text.splitlines())) <= WIDTH
    assert not re.search("[─-╿]", text)  # lines of boxes
    assert not [odd for odd in ("<bool>", "\\[", "[bold]", "[/") if odd in text]


@every_command
def test_every_unit_is_shown(page, words):
    shown = " ".join(page(words).split())
    command = COMMANDS[words]
    told = [command.help, *(getattr(each, "help", None) for each in command.params)]
    for unit in UNIT.findall(" ".join(filter(None, told))):
        assert " ".join(unit.split()) in shown


@every_command
def test_a_paragraph_is_broken_once(page, words):
    """A line ends where the next word has no room, and nowhere else."""
    description = page(words).split("\n\n", 1)[1].split("\nOptions:")[0].split("\nArguments:")[0]
    for paragraph in EXAMPLES.sub("", description).split("\n\n"):
        lines = paragraph.splitlines()
        for line, following in pairwise(lines):
            first = following.split()[0]
            assert len(line) + 1 + len(first) > WIDTH - 2, (line, following)


@every_command
def test_examples_can_be_copied(page, words):
    for example in examples(page(words)):
        given = shlex.split(example)
        assert given.pop(0) == "limo"
        command = COMMANDS[()]
        while given and given[0] in getattr(command, "commands", {}):
            command = command.commands[given.pop(0)]
        known = {name for each in command.params for name in (*each.opts, *each.secondary_opts)}
        assert {word for word in given if word.startswith("--")} <= known


@every_command
def test_lists_of_commands_show_whole_sentences(page, words):
    inner = getattr(COMMANDS[words], "commands", {})
    shown = " ".join(page(words).split())
    assert all(each.short_help in shown for each in inner.values())


def test_help_is_the_docstring_with_its_examples_as_they_stand():
    def command():
        """Do it,
        whole.

        More of it.

        Examples:
            limo do --this
        """

    assert help_of(command) == (
        "Do it,\nwhole.\n\nMore of it.\n\n\b\nExamples:\n    limo do --this",
        "Do it, whole.",
    )
