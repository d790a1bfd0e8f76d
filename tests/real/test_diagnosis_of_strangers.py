"""`limo diagnose` on short recordings of other makes, whose physics their authors measured.

The folder of these cases holds what is true of each, and the scorer that says what counts.
"""

from __future__ import annotations

import importlib.util
import io
import json
import os
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from limo_driver.app.cli import main
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
CASES = DATA / "real_cases"
NAMES = sorted(path.parent.name for path in CASES.glob("*/truth.json"))
Z95 = 1.96  # deviations of a 95 % interval

pytestmark = [
    pytest.mark.slow("real recordings, which few have"),
    pytest.mark.skipif(
        not CASES.is_dir(), reason=f"no real cases in {DATA}; name their folder in LIMO_DATA"
    ),
]


@dataclass(frozen=True)
class Scored:
    """What the scorer says of a case, the verdict, and the improved simulation."""

    score: dict[str, Any]
    verdict: dict[str, Any]
    after: Simulation

    @property
    def names(self):
        """Effects of findings that were named, each with its joints."""
        said = (item for item in self.score["said"] if not item.get("identified"))
        return {(item["effect"], tuple(sorted(item["joints"]))) for item in said}

    def effect(self, name):
        """Return the one effect of that name in the improved simulation."""
        (effect,) = (effect for effect in self.after.effects if effect.name == name)
        return effect

    def parameters(self, effect):
        """Return the parameters of a finding."""
        (finding,) = (item for item in self.verdict["findings"] if item["effect"] == effect)
        return finding["parameters"]


def called(command, _limit, log):
    """Run a command of limo in this process, as the scorer asks for it."""
    said = io.StringIO()
    with (
        patch.object(sys, "argv", [str(item) for item in command]),
        redirect_stdout(said),
        redirect_stderr(said),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    log.write_text(said.getvalue())
    return SimpleNamespace(returncode=ended.value.code or 0, stdout=said.getvalue(), stderr="")


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    """Make a function that diagnoses a case, once, and scores what is said of it."""
    spec = importlib.util.spec_from_file_location("score_real", CASES / "score_real.py")
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    scorer.call = called
    out, known = tmp_path_factory.mktemp("scored"), {}

    def of(case):
        if case not in known:
            score = scorer.run(CASES / case, out, ["limo"], 0.0, rescore=False, second=False)
            assert not score["error"], f"{case}: {score['error']}"
            verdict = json.loads((out / case / "verdict.json").read_text(encoding="utf-8"))
            known[case] = Scored(score, verdict, Simulation.load(out / case / "sim.yaml"))
        return known[case]

    return of


def test_of_thirteen_effects_twelve_are_named_at_their_joint_and_one_by_what_equals_it(scored):
    found = {case: scored(case).score for case in NAMES}
    truths = {case: score for case, score in found.items() if score["kind"] == "truth"}
    assert sum(score["wanted"] for score in truths.values()) == 13
    assert sum(score["hit"] for score in truths.values()) == 12
    assert sum(score["near"] for score in truths.values()) == 1
    assert [case for case, score in truths.items() if score["bad"] or score["extra"]] == []
    assert [case for case, score in truths.items() if score["worse"]] == []


def test_motion_held_out_is_predicted_nearly_as_well_as_with_the_true_effect(scored):
    """Within 1.15 of that error, at the joints where the effect matters."""
    closed = [case for case in NAMES if scored(case).score["closed"]]
    assert len(closed) == 9


def test_an_arm_of_a_tonne_that_lacks_nothing_gets_no_name(scored):
    assert scored("kuka_kr300_null").names == set()


def test_the_gas_spring_of_an_arm_of_a_tonne_is_found_in_twenty_seconds(scored):
    """What the same recording has less of torque without the spring is what the spring needs."""
    found = scored("kuka_kr300_spring")
    assert ("spring_load", (2,)) in found.names
    assert not {"payload", "gravity_direction", "torque_gain"} & {name for name, _ in found.names}
    told = found.parameters("spring_load")
    stiffness, rest, cubic = (told[name]["value"] for name in ("stiffness", "rest", "cubic"))
    deviation = {name: np.diff(told[name]["ci95"])[0] / 2 / Z95 for name in told}
    assert deviation["stiffness"] < 0.02 * stiffness
    assert stiffness + 3 * cubic * rest**2 == pytest.approx(7222, abs=3 * deviation["stiffness"])

    with_spring, without = (
        Recording.load(CASES / case / "recording.parquet")
        for case in ("kuka_kr300_spring", "kuka_kr300_null")
    )
    q, true = with_spring.position[:, 1], (with_spring.torque - without.torque)[:, 1]
    x = q - rest
    slope = stiffness + 3 * cubic * x**2
    by_each = (x * deviation["stiffness"], slope * deviation["rest"], x**3 * deviation["cubic"])
    spread = np.sqrt(np.sum(np.square(by_each), axis=0))
    assert np.interp(0.0, np.sort(q), true[np.argsort(q)]) == pytest.approx(631.7, abs=0.1)
    assert (spread < 0.1 * true.std()).all()
    assert (np.abs(stiffness * x + cubic * x**3 - true) < Z95 * spread).all()


def test_the_cogging_of_a_servo_is_found_line_by_line(scored):
    """7 pole pairs, 12 slots: the authors measured 7, 12, 14, 28, 36 and 84 in a revolution."""
    found = scored("odrive_cogging")
    assert ("torque_ripple", (1,)) in found.names
    lines = np.array(found.effect("torque_ripple").cycles_per_rev)
    assert all(np.abs(lines - N).min() < 0.2 for N in (7, 12, 14, 28, 36, 84))
