"""Ctrl-C ends a command with one line, whatever it is about to do; with real processes."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.waits

ROOT = Path(__file__).parents[4]
LIMO = (sys.executable, "-c", "from limo_driver.app.cli import main; main()")
SAID = "limo: interrupted"
SEED = 18  # of a random moment for each command
LATEST = 1.0  # [s]
STARTS = pytest.mark.slow("starts a process and interrupts it, once more for each import")
LISTENING = "importlib.metadata"  # the first module that `main` imports behind its guard
COMMANDS = {
    "help": "--help",
    "plan": "plan --scaffolds 20 --out p.parquet",
    "excite": "excite --out e.parquet",
    "run": "run --backend mujoco --trajectory motion.parquet --record {}.parquet",
    "identify": "identify run.parquet --robot iiwa14 --out t.yaml",
    "train": "train run.parquet --sim sim.yaml --out network",
    "joint-physics": "train run.parquet --sim sim.yaml --model joint-physics --out physics",
    "evaluate": "evaluate run.parquet --model model --out evaluation",
    "predict": "predict run.parquet --sim sim.yaml --out torque.parquet",
    "diagnose": "diagnose run.parquet --sim sim.yaml --out diagnosis",
    "serve": "serve --arm {} --model model --duration 20",
    "watch": "watch --duration 20",
    "bridge": "bridge --arm {} --duration 20",
    "models": "models add model --golden run.parquet",
    "convert": "convert run.parquet --out {}.mcap",
    "secure": "secure --out {} --driver a --service b",
    "controller": "controller --client 127.0.0.1:9 --duration 20",
    "drives": "drives --config can.yaml --duration 20",
    "doctor": "doctor fri --port 0 --seconds 20",
    "reproduce": "reproduce table1 --quick --out {}",
}


def interrupted(arguments, folder, module, after=0.0):
    """Press Ctrl-C once a module was imported, and some time later; return status and stderr.

    Python itself says on stderr what it has imported.
    """
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"PYTHONPROFILEIMPORTTIME": "1", "PYTHONPATH": path}
    process = subprocess.Popen(
        [*LIMO, *arguments.split()],
        cwd=folder, env=environment, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    with process:
        told = []
        for line in process.stderr:
            if line.startswith("import time:"):
                if line.rstrip().rpartition(" ")[2] == module:
                    break
            else:
                told.append(line)
        else:
            raise AssertionError(f"{module} was never imported: {told}")
        time.sleep(after)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to all at once
        told += [line for line in process.stderr if not line.startswith("import time:")]
    return process.returncode, [line.rstrip() for line in told]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder that holds what every command asks for."""
    path = tmp_path_factory.mktemp("stopping")
    example = (ROOT / "examples" / "can_cia402.yaml").read_text()
    (path / "can.yaml").write_text(example)
    for command in (
        "plan --scaffolds 1 --out motion.parquet",
        "run --backend mujoco --trajectory motion.parquet --record run.parquet",
        "identify run.parquet --robot iiwa14 --out sim.yaml",
        "train run.parquet --sim sim.yaml --model joint-physics --out model",
    ):
        subprocess.run([*LIMO, *command.split()], cwd=path, check=True, capture_output=True)
    return path


@pytest.mark.parametrize(
    ("command", "module"),
    [
        ("help", LISTENING),
        ("plan", "numpy"),
        pytest.param("help", "typer", marks=STARTS),
        pytest.param("plan", "limo_driver.app.console.command_line", marks=STARTS),
        pytest.param("excite", "pinocchio", marks=STARTS),
        pytest.param("controller", "numba", marks=STARTS),
        pytest.param("serve", "limo_driver.app.cli.serve", marks=STARTS),
        pytest.param("watch", "zenoh", marks=STARTS),
    ],
)
def test_while_it_imports(command, module, tmp_path):
    arguments = COMMANDS[command].format("arm")
    assert interrupted(arguments, tmp_path, module) == (130, [SAID])


@pytest.mark.slow("starts every command")
@pytest.mark.parametrize("name", COMMANDS)
def test_at_a_random_moment_of_the_first_second(name, folder):
    moment = random.Random(f"{SEED} {name}").random()  # noqa: S311
    arguments = COMMANDS[name].format(name)
    # most of them early
    status, told = interrupted(arguments, folder, LISTENING, LATEST * moment**2)
    text = "\n".join(told)
    assert not [w for w in ("Traceback", "Exception ignored", "Keyboard") if w in text], text
    if status == -signal.SIGINT:  # Python had taken its handlers down already: 130 to a shell
        assert told == []
    elif status:  # else it had ended, or ends well by Ctrl-C, as a service does
        assert status == 130
        assert told.count(SAID) == 1 or name == "run"  # which says that the arm holds


@pytest.mark.slow("makes recordings and a model first")
@pytest.mark.parametrize("command", ["identify", "run"])
def test_nothing_half_written_is_left(command, folder):
    """What was there before is there, and nothing that no command reads."""
    before = {path.name for path in folder.iterdir()}
    arguments = COMMANDS[command].format("cut")
    assert interrupted(arguments, folder, "limo_driver.runtime.outputs")[0] == 130
    assert {path.name for path in folder.iterdir()} == before


def program(code, *folders):
    """Run code to its end, with the modules of some folders."""
    path = os.pathsep.join(map(str, (ROOT, *folders)))
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_an_import_that_goes_on_regardless_is_stopped_at_the_next(tmp_path):
    """As compiled modules do, which lose what a callback of theirs raises."""
    (tmp_path / "deaf.py").write_text(
        "import os, signal\ntry: os.kill(os.getpid(), signal.SIGINT)\n"
        "except KeyboardInterrupt: pass\nimport wave\nprint('not here')\n"
    )
    code = (
        "from limo_driver.app.console.stopping import Stopping\n"
        "with Stopping(130):\n import deaf\n print('nor here')\n"
    )
    ended = program(code, tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", f"{SAID}\n")


BEGIN = "import atexit, os, signal, sys\nfrom limo_driver.app.console.stopping import Stopping\n"


@pytest.mark.parametrize(
    "code",
    [
        pytest.param(
            "class Deaf:\n def __del__(self): os.kill(os.getpid(), signal.SIGINT)\n"
            "with Stopping(130):\n Deaf()\n signal.pause()\n",
            id="that nobody can raise",
        ),
        pytest.param(
            "with Stopping(130):\n"
            " try: os.kill(os.getpid(), signal.SIGINT)\n"
            " except KeyboardInterrupt: sys.excepthook(*sys.exc_info())  # as PyErr_Print does\n"
            " signal.pause()\n",
            id="that a compiled module prints and forgets",
        ),
        pytest.param(
            "atexit.register(signal.raise_signal, signal.SIGINT)\nwith Stopping(130): pass\n",
            id="while the interpreter ends",
        ),
    ],
)
def test_an_interrupt_is_answered(code):
    ended = program(BEGIN + code)
    assert (ended.returncode, ended.stderr) == (130, f"{SAID}\n")


def test_a_command_that_ends_well_by_an_interrupt_says_nothing():
    code = (
        "with Stopping(130):\n try: os.kill(os.getpid(), signal.SIGINT)\n"
        " except KeyboardInterrupt: pass\n"
    )
    ended = program(BEGIN + code)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.slow("starts a process that imports everything")
def test_no_command_loads_a_window_library():
    """The one that MuJoCo comes with is slow to load, and prints at Ctrl-C."""
    code = (
        "import sys; sys.argv = ['limo', '--help']\n"
        "from limo_driver.app.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "import backends.mujoco_sim.robot\n"
        "print('glfw' in sys.modules)"
    )
    given = {**os.environ}
    given.pop("MUJOCO_GL", None)
    ended = subprocess.run(
        [sys.executable, "-c", code], env=given, capture_output=True, text=True, check=True
    )
    assert ended.stdout.splitlines()[-1] == "False"
