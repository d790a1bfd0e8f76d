"""Whether an improved simulation is better on a recording, joint by joint, and why it is not."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

import limo_driver as limo
from estimators.diagnosis.comparison import compare_simulations
from limo_driver.app.cli import main
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.physics import SpringLoad, TorqueOffset


@pytest.fixture
def spoilt(true_arm):
    """The arm with a spring at joint 2 that is not there, and the rest of it right."""
    spring = SpringLoad(joint=2, stiffness=3.0, rest=0.0)
    return replace(true_arm, effects=(*true_arm.effects, spring))


@pytest.fixture
def off(true_arm):
    """The arm with an offset at joint 1 that is not there."""
    return replace(true_arm, effects=(*true_arm.effects, TorqueOffset(joint=1, offset=0.5)))


def test_it_says_where_it_is_better_and_which_part_makes_a_joint_worse(spoilt, off, test_recording):
    found = compare_simulations(spoilt, off, test_recording)
    assert found.states == ("better", "worse")
    assert found.worse == (2,)
    assert [item.part for item in found.culprits[1]] == ["spring load, joint 2"]
    gone = float(found.improved[1] - found.given[1])
    assert found.culprits[1][0].by == pytest.approx(gone)
    assert (found.low <= found.improved - found.given).all()
    assert (found.improved - found.given <= found.high).all()
    assert "worse because of spring load, joint 2" in str(found)


def test_of_two_that_are_the_same_neither_is_better(true_arm, test_recording):
    found = compare_simulations(true_arm, true_arm, test_recording)
    assert found.states == ("no different", "no different")
    assert not list(found.reasons())


def test_errors_are_those_of_a_score(spoilt, true_arm, test_recording):
    found = compare_simulations(spoilt, true_arm, test_recording)
    np.testing.assert_allclose(found.improved, spoilt.score(test_recording).rmse)
    np.testing.assert_allclose(found.given, true_arm.score(test_recording).rmse)


def test_what_the_maker_says_of_the_torque_is_compared_too(spoilt, true_arm, test_recording):
    recording = test_recording
    rest = np.tile([0.3, 0.4], (len(recording), 1))
    told = replace(recording, extras={"own": recording.torque - rest, "external_torque": rest})
    found = compare_simulations(spoilt, true_arm, told, estimate="own")
    assert set(found.estimates) == {"own", "external_torque"}
    for values in found.estimates.values():
        np.testing.assert_allclose(values, [0.3, 0.4], rtol=1e-6)
    assert "own [N m]" in found.figures()


def test_columns_that_are_not_there_are_named(true_arm, test_recording):
    told = replace(test_recording, extras={"other": test_recording.torque})
    with pytest.raises(RecordingError, match=r"no columns own_1 … own_2 .* it has: other"):
        compare_simulations(true_arm, true_arm, told, estimate="own")


def test_a_simulation_of_another_arm_is_refused(true_arm, test_recording):
    with pytest.raises(ConfigError, match="`against` is of the joints"):
        compare_simulations(true_arm, limo.Simulation("iiwa14"), test_recording)


def test_a_simulation_alone_is_compared_with_nothing(true_arm, test_recording):
    with pytest.raises(ConfigError, match="`against` is missing"):
        limo.evaluate(true_arm, test_recording)


def test_it_is_saved_as_values_and_page(spoilt, off, test_recording, tmp_path):
    found = limo.evaluate(spoilt, test_recording, against=off)
    found.save(tmp_path)
    values = json.loads((tmp_path / "evaluation.json").read_text())
    assert values["state"] == ["better", "worse"]
    assert values["worse_because"][1][0]["part"] == "spring load, joint 2"
    assert "worse because of spring load" in (tmp_path / "report.html").read_text()


@pytest.fixture
def files(spoilt, off, test_recording, tmp_path):
    spoilt.save(tmp_path / "improved.yaml")
    off.save(tmp_path / "given.yaml")
    test_recording.save(tmp_path / "run.parquet")
    return tmp_path


def test_the_command_prints_the_values(files, monkeypatch, capsys):
    status, told, _ = _limo(files, monkeypatch, capsys, "improved.yaml", "given.yaml", "--json")
    assert status == 0
    assert json.loads(told)["state"] == ["better", "worse"]


@pytest.mark.parametrize(
    ("sim", "against", "more", "message"),
    [
        (None, "given.yaml", (), "no --sim given with --against, expected two simulations"),
        ("improved.yaml", None, (), "--sim alone given, expected --model, or"),
        ("improved.yaml", "given.yaml", ("--estimate", "kuka"), "has no columns kuka_1 … kuka_2"),
    ],
)
def test_bad_input_of_the_command_is_one_line(
    files, monkeypatch, capsys, sim, against, more, message
):
    status, _, said = _limo(files, monkeypatch, capsys, sim, against, *more)
    assert status == 2
    assert message in said
    assert said.count("limo:") == 1


def _limo(files, monkeypatch, capsys, sim, against, *more):
    """Run `limo evaluate` in this process; return exit status, stdout and stderr."""
    given = {"--sim": sim, "--against": against}
    options = [x for name, file in given.items() if file for x in (name, files / file)]
    call = ["limo", "evaluate", files / "run.parquet", *options, *more]
    monkeypatch.setattr(sys, "argv", [str(item) for item in call])
    with pytest.raises(SystemExit) as ended:
        main()
    return (ended.value.code or 0, *capsys.readouterr())
