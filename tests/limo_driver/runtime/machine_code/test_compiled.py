"""Machine code that is kept: found again, never stale, and never in the way."""

import errno
import importlib.util
import os
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import numpy as np
import pytest
from lanes import sampled

from limo_driver.app.console.command_line import compilation_line
from limo_driver.runtime import compilation, machine_code
from limo_driver.runtime.compiled import compiled

pytestmark = pytest.mark.waits

INNER = """
    from limo_driver.runtime.compiled import compiled

    @compiled()
    def tripled(x):
        return {factor} * x
"""
OUTER = """
    import numpy as np
    from limo_driver.runtime.compiled import compiled
    from inner import tripled

    OFFSET = {offset}

    @compiled(reads=("x",))
    def total(x):
        found = OFFSET
        for k in range(x.size):
            found += tripled(x[k])
        return found

    def answer():
        return total(np.ones(2))
"""
ASK = "import outer; print(outer.answer(), sum(outer.total.stats.cache_misses.values()))"


def write(folder: Path, *, factor=3.0, offset=0.0):
    """Write a module with a compiled function, and another that it calls into."""
    (folder / "inner.py").write_text(textwrap.dedent(INNER.format(factor=factor)))
    (folder / "outer.py").write_text(textwrap.dedent(OUTER.format(offset=offset)))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of the modules, whose machine code goes to `cache`, beside them."""
    write(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(machine_code, "_warned", False)
    yield tmp_path
    for name in ("inner", "outer"):
        sys.modules.pop(name, None)


def ask(folder: Path):
    """Return the answer as a new process would, and whether that compiled."""
    for name in ("inner", "outer"):
        place = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
        module = sys.modules[name] = importlib.util.module_from_spec(place)
        source = (folder / f"{name}.py").read_text()
        exec(compile(source, folder / f"{name}.py", "exec"), module.__dict__)  # noqa: S102
    answer = module.answer()
    return answer, bool(module.total.stats.cache_misses)


def kept(folder: Path, of="outer.total"):
    return list((folder / "cache" / "limo").glob(f"{of}-*.code"))


def process(folder: Path, code=ASK, **environment):
    """Run code in a process that finds the modules; None takes a variable away."""
    settings = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{os.environ['PYTHONPATH']}"}
    settings |= {key: value for key, value in environment.items() if value is not None}
    for key, value in environment.items():
        if value is None:
            settings.pop(key, None)
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-c", code], env=settings, stdout=pipe, stderr=pipe, text=True
    )


@pytest.fixture(autouse=True)
def own_path(monkeypatch):
    """Have processes import the modules under test, wherever they stand."""
    root = Path(compilation.__file__).parents[3]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")]))


def test_code_is_compiled_once(folder):
    assert ask(folder) == (6.0, True)
    assert ask(folder) == (6.0, False)
    assert len(kept(folder)) == 1


def test_what_two_threads_asked_for_at_once_is_found_at_once_ever_after(monkeypatch):
    """An entry that is there twice is ambiguous to numba, which then asks at every call."""

    @compiled(reads=("values",))
    def first(values):
        return values[0]

    asked, gate, compile_one = [], threading.Barrier(2), first.compile

    def compile_when_both_asked(signature):
        asked.append(signature)
        if len(asked) <= 2:
            gate.wait(120.0)
        return compile_one(signature)

    monkeypatch.setattr(first, "compile", compile_when_both_asked)
    values = np.ones(3)
    threads = [threading.Thread(target=first, args=(values,)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(asked) == 2
    assert first(values) == 1.0
    assert len(asked) == 2


@sampled(
    "change",
    [{"factor": 4.0}, {"offset": 2.0}],
    "starts processes that compile",
    ids=["called", "own"],
)
def test_a_change_of_the_sources_is_seen_whatever_their_times(folder, change):
    times = (folder / "inner.py").stat()
    ask(folder)
    write(folder, **change)
    for name in ("inner.py", "outer.py"):
        os.utime(folder / name, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert ask(folder) == (8.0, True)


@pytest.mark.slow("starts processes that compile")
def test_a_file_that_changes_after_its_import_leaves_no_code_for_what_it_says_now(folder):
    """As `git pull` does while a service runs."""
    change = (
        "import outer, pathlib, inner\n"
        "path = pathlib.Path(inner.__file__)\n"
        # of another length: Python takes kept byte code for the file's by its seconds and its size
        "path.write_text(path.read_text().replace('3.0', '4.00'))\n"
        "print(outer.answer())"
    )
    assert process(folder, change).communicate()[0].split() == ["6.0"]
    assert process(folder).communicate()[0].split() == ["8.0", "1"]


@pytest.mark.slow("starts processes that compile")
def test_a_constant_that_a_process_changes_leaves_no_code_for_the_others(folder):
    change = (
        "import outer, numpy as np\n"
        "outer.tripled(1.0)\n"  # asks what of the rest is kept
        "outer.OFFSET = 5.0\n"
        "print(outer.answer())"
    )
    assert process(folder, change).communicate()[0].split() == ["11.0"]
    assert process(folder).communicate()[0].split() == ["6.0", "1"]


@pytest.mark.slow("starts processes that compile")
def test_a_constant_in_a_module_of_a_module_is_seen(folder):
    (folder / "constants.py").write_text("K = 1.0")
    (folder / "package.py").write_text("import constants")
    (folder / "user.py").write_text(
        "import package\nfrom limo_driver.runtime.compiled import compiled\n"
        "@compiled()\ndef plus(x):\n    return x + package.constants.K\n"
    )
    ask_user = "import user; print(user.plus(1.0))"
    assert process(folder, ask_user).communicate()[0].split() == ["2.0"]
    (folder / "constants.py").write_text("K = 2.5")
    assert process(folder, ask_user).communicate()[0].split() == ["3.5"]


@pytest.mark.slow("starts processes that compile")
def test_processes_find_the_same_names_in_whatever_order():
    """Sets, such as options of fast arithmetic, have another order in each process."""
    code = (
        "from estimators.joint_physics.columns import scan\n"
        "from backends.mujoco_sim.engine import _advance\n"
        "from limo_driver.runtime.machine_code import digest\n"
        "print(digest(scan), digest(_advance))"
    )
    found = {
        process(Path(), code, PYTHONHASHSEED=seed).communicate()[0] for seed in ("1", "2", "3")
    }
    assert len(found) == 1
    assert len(found.pop().split()) == 2


@pytest.mark.usefixtures("folder")
def test_a_function_keeps_its_bits_whoever_calls_it_first():
    """Of itself, numba has a callee fuse products and sums where its first caller may."""

    @compiled()
    def left(x, y):
        return x * x - y

    @compiled(fastmath={"contract"})
    def ask_for(x, y):
        return left(x, y)

    x = 1 + 2.0**-27
    assert ask_for(x, x * x) == 0.0  # fused, it is the rounding of the product, 2⁻⁵⁴


@pytest.mark.slow("starts processes that compile")
def test_versions_that_share_a_cache_leave_each_other_alone(folder):
    ask(folder)
    write(folder, factor=4.0)
    ask(folder)
    write(folder)
    assert ask(folder) == (6.0, False)
    write(folder, factor=4.0)
    assert ask(folder) == (8.0, False)


def test_the_code_of_one_processor_is_not_run_as_that_of_another(folder):
    assert ask(folder) == (6.0, True)
    other, _ = process(folder, NUMBA_CPU_NAME="generic").communicate()
    assert other == "6.0 1\n"  # it compiled
    assert len(kept(folder)) == 2
    assert ask(folder) == (6.0, False)


@pytest.mark.slow("compiles many versions")
def test_old_versions_do_not_pile_up(folder):
    for factor in range(machine_code._KEPT + 2):
        write(folder, factor=float(factor))
        ask(folder)
    assert len(kept(folder)) == machine_code._KEPT


def test_what_killed_writers_left_is_removed(folder):
    ask(folder)
    (file,) = kept(folder)
    left = file.with_name(f"{file.name}.0.tmp")
    left.write_bytes(b"half")
    os.utime(left, (0, 0))
    file.unlink()
    ask(folder)
    assert not left.exists()


def _cut(file):
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def _empty(file):
    file.write_bytes(b"")


def _turn_a_bit(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def _of_no_known_class(file):
    file.write_bytes(machine_code._packed(b"cno_such_module\nThing\n."))


def _of_something_else(file):
    file.write_bytes(machine_code._packed(b"\x80\x04]\x94."))  # an empty list, pickled


def _a_folder(file):
    file.unlink()
    file.mkdir()


@sampled(
    "damage",
    [_cut, _empty, _turn_a_bit, _of_no_known_class, _of_something_else, _a_folder],
    "compiles each time",
)
def test_damaged_files_are_compiled_anew(folder, damage):
    ask(folder)
    for file in (*kept(folder), *kept(folder, "inner.tripled")):
        damage(file)
    assert ask(folder) == (6.0, True)


def test_a_cache_that_cannot_be_written_costs_one_line(folder, caplog):
    (folder / "cache").write_text("a file stands where the folder should")
    assert ask(folder) == (6.0, True)
    assert ask(folder) == (6.0, True)
    (record,) = caplog.records
    assert "cannot keep machine code" in record.getMessage()
    assert str(folder / "cache") in record.getMessage()


def test_a_full_disk_costs_one_line_and_leaves_no_file(folder, caplog, monkeypatch):
    def full(self, content):
        with self.open("wb") as file:
            file.write(content[:100])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))

    monkeypatch.setattr(Path, "write_bytes", full)
    assert ask(folder) == (6.0, True)
    assert len(caplog.records) == 1
    assert "No space left" in caplog.text
    assert list((folder / "cache" / "limo").iterdir()) == []


@pytest.mark.slow("starts processes that compile")
def test_without_a_home_and_beside_modules_that_cannot_be_written(folder):
    """A file stands where Python's own cache of these modules would."""
    (folder / "__pycache__").write_text("")
    gone = {"NUMBA_CACHE_DIR": None, "XDG_CACHE_HOME": None}
    here = process(folder, **gone, HOME=str(folder / "home"))
    assert here.communicate() == ("6.0 1\n", "")
    assert len(list((folder / "home/.cache/limo").glob("outer.total-*.code"))) == 1
    # without HOME, the password file says where home is; here it does not know the user
    code = f"import pwd\ndef getpwuid(_): raise KeyError\npwd.getpwuid = getpwuid\n{ASK}"
    out, err = process(folder, code, **gone, HOME=None).communicate()
    assert (out, err.count("\n")) == ("6.0 1\n", 1)
    assert err.startswith("limo: cannot keep machine code")


WAITS = """
import sys
from limo_driver.runtime import compilation
from limo_driver.app.console.stopping import Stopping

def wait(state):
    if state.running:
        print("compiling", flush=True)
        sys.stdin.readline()

with Stopping(130), compilation.report_to(wait):
    import outer
    print(outer.answer())
    print(sum(outer.total.stats.cache_misses.values()))
"""


def compiling(folder: Path):
    settings = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{os.environ['PYTHONPATH']}"}
    pipe = subprocess.PIPE
    child = subprocess.Popen(
        [sys.executable, "-c", WAITS], env=settings, stdin=pipe, stdout=pipe, stderr=pipe, text=True
    )
    assert child.stdout.readline() == "compiling\n"
    return child


@pytest.mark.slow("starts processes that compile")
def test_of_two_processes_one_compiles_and_the_other_waits_for_it(folder):
    both = [compiling(folder) for _ in range(2)]  # neither goes on before the other has begun
    for each in both:
        out, err = each.communicate("\n" * 10_000)
        *lines, answer, compiled_here = out.splitlines()
        assert (answer, err) == ("6.0", "")
        assert set(lines) <= {"compiling"}
        assert compiled_here == str(int(each is both[0]))
    assert ask(folder) == (6.0, False)
    assert not list(folder.rglob("*.lock"))


@pytest.mark.slow("starts processes that compile")
def test_killed_while_compiling(folder):
    child = compiling(folder)
    child.kill()
    child.communicate()
    assert ask(folder) == (6.0, True)
    assert ask(folder) == (6.0, False)


@pytest.mark.slow("starts processes that compile")
def test_killed_while_writing(folder):
    killed = "import os, pathlib; pathlib.Path.replace = lambda *_: os.kill(os.getpid(), 9)"
    child = process(folder, f"{killed}\n{ASK}")
    child.communicate()
    assert child.returncode == -signal.SIGKILL
    assert ask(folder) == (6.0, True)
    assert ask(folder) == (6.0, False)


@pytest.mark.slow("compiles in a process of its own")
def test_ctrl_c_while_compiling_is_one_line_and_130(folder):
    child = compiling(folder)
    child.send_signal(signal.SIGINT)
    out, err = child.communicate("\n" * 1000)
    assert child.returncode == 130
    assert err == "limo: interrupted\n"
    assert "6.0" not in out


def test_compilation_is_told(folder):
    states = []
    with compilation.report_to(states.append):
        ask(folder)
    assert states[0].running
    assert compilation.current() is states[-1]
    assert not compilation.is_running()
    assert next(s.function for s in states if s.running) == "outer.total"
    assert states[-1].done - states[0].done == 2  # with what it calls
    assert all(s.done <= s.most for s in states)
    assert [s.seconds for s in states] == sorted(s.seconds for s in states)
    states.clear()
    with compilation.report_to(states.append):
        ask(folder)
    assert not states


@pytest.mark.parametrize(
    ("spent", "silent", "lines"), [(0.1, False, 0), (1.0, False, 1), (9.0, True, 0)]
)
def test_one_line_where_it_takes_long(capsys, spent, silent, lines):
    with compilation_line(silent=silent):
        for done in range(3):
            compilation.tell(compilation.Compilation("f", True, done, 31, spent))
        compilation.tell(compilation.Compilation("f", False, 3, 31, spent))
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == ["compiling once on this machine: 1 of up to 31"][:lines]
