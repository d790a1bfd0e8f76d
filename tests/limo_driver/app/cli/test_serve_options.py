"""What `limo serve` makes of its options before anything is opened.

Bulletins of a service before it serves: what compiles while it loads is told as compiling.
"""

import json
import re
import sys
from contextlib import contextmanager, suppress
from types import SimpleNamespace

import numpy as np
import pytest

from limo_driver.app.cli import main
from limo_driver.app.cli.export import read_all
from limo_driver.app.cli.serve import log_limits, per_joint, teller
from limo_driver.app.library import serving
from limo_driver.app.library.learning import nominal
from limo_driver.app.library.serving import COMPILING, Bulletins
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.network.readiness import ServicePhase
from limo_driver.recordings.recording import Recording
from limo_driver.runtime import compilation
from limo_driver.runtime.compilation import Compilation

pytestmark = pytest.mark.waits


class TestLogLimits:
    def test_are_shared_by_the_arms_and_hold_with_the_file_under_way(self):
        limits = log_limits(20.0, 30.0, arms=2)
        assert (limits.total_bytes, limits.total_seconds) == (10e9, 30 * 86400)
        small = log_limits(0.1, 1.0, arms=1)
        assert small.file_bytes == pytest.approx(0.01e9)

    def test_can_be_none(self):
        limits = log_limits(np.inf, np.inf, arms=1)
        assert (limits.total_bytes, limits.total_seconds) == (np.inf, np.inf)
        assert limits.file_bytes < np.inf

    @pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
    def test_are_refused_by_the_name_of_their_option(self, value):
        with pytest.raises(ConfigError, match=rf"--log-size is {value:g} GB, expected above 0"):
            log_limits(value, 30.0, arms=1)
        with pytest.raises(ConfigError, match=rf"--log-age is {value:g} days, expected above 0"):
            log_limits(20.0, value, arms=1)


class TestContact:
    def test_is_one_number_or_one_for_each_joint(self):
        assert per_joint("--contact", "4", "N m") == (4.0,)
        assert per_joint("--contact", "8,8, 6,6,4,2,1", "N m")[-1] == 1.0

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("4;4", "--contact is '4;4', expected numbers with commas between"),
            ("", "--contact is '', expected numbers"),
            ("0", "--contact is 0 N m, expected above 0 and finite"),
            ("nan", "--contact is nan N m, expected above 0"),
            ("8,8,6,6,4,2,inf", "--contact is 8,8,6,6,4,2,inf N m, expected above 0"),
        ],
    )
    def test_is_refused_by_the_name_of_its_option(self, text, message):
        with pytest.raises(ConfigError, match=message):
            per_joint("--contact", text, "N m")


@pytest.mark.parametrize("command", [("serve", "--arm", "a"), ("watch",)])
def test_a_duration_is_a_number(limo, command):
    done = limo(*command, "--duration", "nan")
    assert done.returncode == 2
    assert re.search("--duration.*(is nan|greater than or equal to 0)", done.stderr)


@pytest.mark.parametrize("closed", [False, True])
def test_an_open_network_is_said_at_the_start(monkeypatch, capsys, tmp_path, closed):
    @contextmanager
    def opened(*_, **__):
        yield SimpleNamespace(wait=lambda _: None, lost_logs={})

    monkeypatch.setattr(serving, "serve", opened)
    (tmp_path / "zenoh.json5").write_text("{}")
    config = ["--config", str(tmp_path / "zenoh.json5")] if closed else []
    options = ["--arm", "iiwa14", "--model", "model", "--duration", "0", *config]
    monkeypatch.setattr(sys, "argv", ["limo", "serve", *options])
    with suppress(SystemExit):
        main()
    said = capsys.readouterr().err
    assert ("the network is open" in said) == (not closed)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--store", "s"), "--free takes --model"),
        (("--model", "m", "--contact", "3"), "--contact and --free both say what a contact is"),
        (("--model", "m"), "m: cannot be read"),
    ],
)
def test_free_motion_that_cannot_say_what_a_contact_is(limo, tmp_path, options, said):
    t = np.arange(0.0, 1.0, 0.01)
    Recording.from_arrays(t, np.sin(t)[:, None], np.cos(t)[:, None]).save(tmp_path / "a.parquet")
    done = limo("serve", "--arm", "a", "--free", tmp_path / "a.parquet", *options)
    assert done.returncode == 2
    assert said in done.stderr


def test_free_motion_may_be_a_log_of_any_format_with_its_mapping(tmp_path):
    """What `export` and `serve` take alike."""
    t = np.arange(0.0, 2.0, 0.01)
    log = {"t": t} | {f"q{j}": np.sin(t + j) for j in range(1, 8)}
    log |= {f"tau{j}": np.cos(t + j) for j in range(1, 8)}
    rows = "\n".join(",".join(map(repr, row)) for row in np.column_stack([*log.values()]).tolist())
    (tmp_path / "calm.csv").write_text(f"{','.join(log)}\n{rows}\n", encoding="utf-8")
    joints = RobotModel.load("iiwa14").joint_names
    channels = {
        quantity: f"{{columns: [{', '.join(f'{word}{j}' for j in range(1, 8))}], unit: {unit}}}"
        for quantity, word, unit in (("position", "q", "rad"), ("torque", "tau", "N m"))
    }
    lines = [f"joints: [{', '.join(joints)}]", "time: {columns: [t], unit: s}"]
    lines += [f"{quantity}: {text}" for quantity, text in channels.items()]
    (tmp_path / "map.yaml").write_text("\n".join(lines), encoding="utf-8")
    nominal("iiwa14").save(tmp_path / "sim.yaml")
    (calm,) = read_all([tmp_path / "calm.csv"], tmp_path / "sim.yaml", tmp_path / "map.yaml")
    np.testing.assert_allclose(calm.torque[:, 2], np.cos(t + 3), atol=1e-12)


def test_a_service_that_compiles_while_it_loads_is_compiling_from_then_on(capsys, monkeypatch):
    monkeypatch.setattr(compilation, "_last", None)  # of this process, put back at the end
    bulletins = Bulletins(["iiwa14"], teller(several=False, as_json=True))
    told = bulletins.of["iiwa14"]
    bulletins.enter(ServicePhase.LOADING, "loading models and physics")
    with compilation.report_to(bulletins.tell_compiled):
        assert told.phase is ServicePhase.LOADING
        compilation.tell(Compilation("f", running=True, done=0, most=2, seconds=0.0))
        assert told.phase is ServicePhase.COMPILING
        assert told.state == "compiling, 0 of at most 2 functions done"
        compilation.tell(Compilation("f", running=False, done=1, most=2, seconds=0.1))
        bulletins.enter(ServicePhase.COMPILING, COMPILING)
        assert told.phase is ServicePhase.COMPILING
    events = [json.loads(line)["event"] for line in capsys.readouterr().out.splitlines()]
    assert events == ["loading", "compiling"]
