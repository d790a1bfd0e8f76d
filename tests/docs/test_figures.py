"""README and docs tell the figures that benchmarks printed, of named versions, and no others."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from figures import BLOCK, PAGES, PRINT, RESULTS, SPAN, Published
from measured import unheld

ROOT = Path(__file__).parents[2]
BENCHMARKS = ROOT / "benchmarks"
KEPT = sorted(RESULTS.glob("*.txt"))
HEAD = re.compile(r"# 20\d\d-\d\d-\d\d, version [\w.-]*[0-9a-f]{7,}; ")
NOT_MEASURED = {  # statements with numbers that look like figures, and why they are none
    "README.md": ["a reference"],
    "diagnosis_method.md": ["a setting"],
    "estimators.md": ["how it is made"],
    "models.md": ["a test holds it"],
    "physics.md": ["tests hold it"],
    "without_torque.md": ["how it is made", "how it is made"],
}


def test_pages_have_the_figures_that_benchmarks_printed():
    done = published(ROOT, "--check")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_page_tells_a_figure_that_no_result_holds(page):
    assert list(map(str, unheld(page.name, page.read_text(encoding="utf-8")))) == []


def test_statements_that_look_like_figures_say_why_they_are_none():
    told = {page.name: re.findall(r"<!-- not measured: (.+?) -->", page.read_text())
            for page in PAGES}  # fmt: skip
    assert {name: why for name, why in told.items() if why} == NOT_MEASURED


@pytest.mark.parametrize("path", KEPT, ids=lambda path: path.stem)
def test_a_result_is_of_a_named_version_and_of_the_commands_that_are_published(path):
    head, _, printed = path.read_text(encoding="utf-8").partition("\n")
    assert HEAD.match(head)
    assert "dirty" not in head
    commands = [line[2:] for line in printed.splitlines() if line.startswith("$ python ")]
    run = Published.load().runs[path.stem]["commands"]
    assert commands == [command for command in run if command.startswith("python ")]


@pytest.mark.parametrize("path", KEPT, ids=lambda path: path.stem)
def test_the_version_of_a_result_is_a_commit_of_this_history(path):
    if git("rev-parse", "--is-shallow-repository").stdout != "false\n":
        pytest.skip("no history here")
    version = re.search(r"version (?:\S*-g)?([0-9a-f]{7,})", path.read_text())[1]
    assert git("merge-base", "--is-ancestor", version, "HEAD").returncode == 0


def git(*words):
    """Ask git about this repository."""
    command = ["git", "-C", str(ROOT), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_every_result_is_shown():
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert KEPT
    assert [path.name for path in KEPT if f"benchmarks/results/{path.name}" not in pages] == []


def test_every_table_and_print_stands_on_a_page():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    given = Published.load()
    assert {match["name"] for match in BLOCK.finditer(text)} == set(given.tables)
    assert {match["name"] for match in PRINT.finditer(text)} == set(given.prints)


@pytest.mark.parametrize(
    "text",
    [
        "On held-out motion the error falls by 44 %.\n",
        "`benchmarks/rest.py` plans it in 22 s.\n",
        "48 of 52 cases are named.\n",
        "An answer takes 12.5 µs.\n",
        "On 2026-11-23 it was 0.47.\n",
        "Of seeds 31 to 40, nine are right, 0.9 within.\n",
        "Errors of both, by `benchmarks/rest.py`:\n\n| a | b |\n|---|---|\n| x | 1.12 |\n",
        "- one\n- it took 3 s of processor time\n",
        "A load on a real UR10e: 3.07 kg.\n",
        "It misses the bar of 1.15.\n",
    ],
)
def test_a_measured_figure_is_seen(text):
    assert unheld("a_page.md", text)


@pytest.mark.parametrize(
    "text",
    [
        "The limit is 0.05 m, the rate 1 kHz.\n",
        "On held-out motion <!-- figure: x -->[44 %](r.txt)<!-- end --> of it go.\n",
        "`benchmarks/rest.py --seed 3` plans it on ROS 2 for the iiwa 14, joints 1 to 3.\n",
        "By `benchmarks/rest.py`:\n\n<!-- figures: a -->\n| 22 s |\n<!-- end of figures -->\n",
        "```text\nheld-out RMSE 0.3\n```\n",
        "Held-out errors within their 95 % interval ([more](a5.md)).\n",
        "RMSE of 0.01 at most <!-- not measured: a test holds it -->\n",
        "Held-out errors are shown.\n\nA period is 5 ms.\n",
    ],
)
def test_no_other_number_is_taken_for_one(text):
    assert unheld("a_page.md", text) == []


def test_of_a_page_of_figures_every_number_is_one():
    assert unheld("benchmarks.md", "It is 0.3 as large.\n")
    assert unheld("README.md", "It is 0.3.\n\n## How good, and what not\nNothing.\n") == []
    assert unheld("README.md", "Before.\n\n## How good, and what not\nIt is 0.3.\n")


class TestPublishing:
    """In a small repository of its own."""

    @pytest.fixture
    def place(self, tmp_path):
        (tmp_path / "benchmarks").mkdir()
        (tmp_path / "docs").mkdir()
        for name in ("publish.py", "figures.py"):
            shutil.copy(BENCHMARKS / name, tmp_path / "benchmarks")
        (tmp_path / "benchmarks" / "one.py").write_text("print('it took 7 s', '8 s', sep='\\n')\n")
        (tmp_path / ".gitignore").write_text("__pycache__/\nout/\n")
        (tmp_path / "README.md").write_text("It takes <!-- figure: time --><!-- end -->.\n")
        write(tmp_path, r"'took (\d+) s'")
        self.git(tmp_path, "init", "--quiet")
        self.commit(tmp_path)
        return tmp_path

    def git(self, place, *words):
        own = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", "-C", place, *own, *words], check=True, capture_output=True)

    def commit(self, place):
        self.git(place, "add", "--all")
        self.git(place, "commit", "--quiet", "--message", "all")

    def test_a_figure_is_read_from_what_a_run_printed(self, place):
        assert published(place, "one").returncode == 0
        readme = (place / "README.md").read_text()
        assert "<!-- figure: time -->[7 s](benchmarks/results/one.txt)<!-- end -->" in readme
        head = (place / "benchmarks" / "results" / "one.txt").read_text().partition("\n")[0]
        assert HEAD.match(head)
        assert published(place, "--check").returncode == 0

    def test_runs_follow_each_other_though_pages_and_results_changed(self, place):
        assert published(place, "one").returncode == 0
        assert published(place, "one").returncode == 0

    @pytest.mark.parametrize("name", ["benchmarks/one.py", "benchmarks/two.py", "estimator.py"])
    def test_a_tree_that_differs_from_its_commit_is_refused(self, place, name):
        with (place / name).open("a") as file:
            file.write("# changed\n")
        done = published(place, "one")
        assert done.returncode == 1
        assert "differs from its last commit" in done.stderr
        assert name in done.stderr
        assert not (place / "benchmarks" / "results").exists()

    def test_a_run_that_changes_the_tree_is_not_kept(self, place):
        (place / "benchmarks" / "one.py").write_text("open('left', 'w').close()\n")
        self.commit(place)
        done = published(place, "one")
        assert done.returncode == 1
        assert "left" in done.stderr
        assert not (place / "benchmarks" / "results").exists()

    def test_a_run_that_fails_is_not_kept(self, place):
        (place / "benchmarks" / "one.py").write_text(
            "print('it took 7 s')\nraise ValueError('x')\n"
        )
        self.commit(place)
        done = published(place, "one")
        assert done.returncode == 1
        assert "nothing is kept" in done.stderr
        assert not (place / "benchmarks" / "results").exists()

    def test_a_run_that_misses_its_aim_is_kept(self, place):
        (place / "benchmarks" / "one.py").write_text("print('it took 9 s')\nraise SystemExit(1)\n")
        self.commit(place)
        assert published(place, "one").returncode == 0
        assert "[9 s]" in (place / "README.md").read_text()

    def test_a_pattern_that_finds_nothing_is_told(self, place):
        write(place, r"'lasted (\d+) s'")
        self.commit(place)
        done = published(place, "one")
        assert done.returncode == 1
        assert "one.txt has nothing that fits 'lasted" in done.stderr

    def test_a_figure_without_a_result_is_told_with_how_to_run_it(self, place):
        done = published(place)
        assert done.returncode == 1
        assert "python benchmarks/publish.py one" in done.stderr

    def test_a_table_says_what_was_not_measured(self, place):
        (place / "README.md").write_text("<!-- figures: times -->\n<!-- end of figures -->\n")
        assert published(place).returncode == 0
        text = (place / "README.md").read_text()
        assert "Not measured yet: `python benchmarks/publish.py one`." in text

    def test_a_page_that_somebody_changed_is_told(self, place):
        assert published(place, "one").returncode == 0
        readme = place / "README.md"
        readme.write_text(readme.read_text().replace("[7 s]", "[6 s]"))
        done = published(place, "--check")
        assert done.returncode == 1
        assert "README.md is out of date" in done.stdout

    def test_an_unknown_name_is_told(self, place):
        assert "no run of published.yaml: two" in published(place, "two").stderr
        (place / "README.md").write_text("<!-- figure: other --><!-- end -->")
        assert "0 figures are named 'other'" in published(place).stderr


def write(place, pattern):
    """Write a file of one run and one figure."""
    (place / "benchmarks" / "published.yaml").write_text(
        "runs:\n  one: {commands: [python benchmarks/one.py], minutes: 1}\n"
        "tables:\n  times:\n    - {what: Time, run: one, name: time, "
        f"find: {{seconds: {pattern}}}, figure: '{{seconds}} s'}}\n"
        "prints: {}\n"
    )


def published(place, *words):
    """Run the script of a repository."""
    command = [sys.executable, str(place / "benchmarks" / "publish.py"), *words]
    return subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)


def test_figures_in_sentences_are_named_once():
    names = [row["name"] for rows in Published.load().tables.values()
             for row in rows if "name" in row]  # fmt: skip
    assert len(names) == len(set(names))
    used = {match["name"] for page in PAGES for match in SPAN.finditer(page.read_text())}
    assert used <= set(names)
