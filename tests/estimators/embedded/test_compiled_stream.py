"""A stream in compiled C is the stream that it was made of, and is only used if it is."""

from __future__ import annotations

import shutil
import stat
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.embedded import compiled_stream
from estimators.embedded.compiled_stream import CompiledStream, fastest
from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.stream import Stream
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.physics import ExternalContact, Simulation

if TYPE_CHECKING:
    from estimators.base import LiveEstimator
    from estimators.joint_physics import JointPhysics
    from limo_driver.recordings.recording import Recording

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")

RATE = 100.0
SINGLE = 3e-7  # some sums are of single precision


@pytest.fixture(autouse=True)
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep libraries where no other test does."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))


def lossy(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, position and torque, some lost, with a short gap and a long one."""
    time = recording.time - recording.time[0]
    time[time.size // 2 :] += 0.7
    time[time.size // 3 :] += 0.15
    here = ~np.isin(np.arange(time.size) % 90, [50, 51, 70])
    return time[here], recording.position[here], recording.torque[here]


def check(model: LiveEstimator | Simulation, motion: Recording) -> None:
    stream, given = Stream(model, RATE), lossy(motion)
    found = CompiledStream(stream)
    expected, _ = stream.advance(stream.init(), *given)
    late, _ = found.advance(found.init(), *given)
    scale = np.abs(expected.torque).max()
    np.testing.assert_allclose(late.torque, expected.torque, rtol=0.0, atol=1e-6 * scale)
    np.testing.assert_allclose(late.measured, expected.measured, rtol=0.0, atol=1e-9 * scale)
    np.testing.assert_allclose(late.std, expected.std, rtol=SINGLE, equal_nan=True)
    np.testing.assert_array_equal(late.outside, expected.outside)
    np.testing.assert_allclose(late.time, expected.time, rtol=0.0, atol=1e-9)
    state, steps = found.init(), []
    for time, position, torque in zip(*given, strict=True):
        one, state = found.step(state, time, position, torque)
        steps.append(one.torque)
    np.testing.assert_array_equal(steps, late.torque)


def test_of_a_simulation(rigid: Simulation, motion: Recording) -> None:
    check(rigid, motion)


def test_of_joint_physics(learned: JointPhysics, motion: Recording) -> None:
    check(learned, motion)


@pytest.mark.slow("trains a network")
def test_of_a_network(rigid: Simulation, training_recording: Recording, motion: Recording) -> None:
    settings = TrainingSettings(
        model="lstm-fcl", features="drive", epochs=1, sequence_length=20, hidden=4, folds=1
    )
    check(HybridModel(rigid, settings).fit([training_recording[slice(0, 1500)]]), motion)


def test_without_torque_none_is_measured(rigid: Simulation, motion: Recording) -> None:
    stream = CompiledStream(Stream(rigid, RATE))
    time, position, _ = lossy(motion)
    late, _ = stream.advance(stream.init(), time, position)
    assert late.measured is None
    expected = Stream(rigid, RATE)
    torque = expected.advance(expected.init(), time, position)[0].torque
    np.testing.assert_allclose(late.torque, torque, atol=1e-9 * np.abs(torque).max())


def test_what_cannot_follow_is_refused_and_changes_nothing(
    rigid: Simulation, motion: Recording
) -> None:
    stream = CompiledStream(Stream(rigid, RATE))
    time, position, torque = lossy(motion)
    _, state = stream.advance(stream.init(), time[:40], position[:40], torque[:40])
    before = bytes(state)
    for wrong in (
        (time[39], position[40], torque[40]),
        (time[40], position[40] * np.nan, torque[40]),
        (time[40], position[40], None),
    ):
        with pytest.raises(RecordingError, match="cannot follow the one before"):
            stream.step(state, *wrong)
        assert bytes(state) == before
    copy = stream.copied(state)
    stream.step(state, time[40], position[40], torque[40])
    assert bytes(state) != before
    assert bytes(copy) == before


def test_memory_is_alike_where_that_of_python_is_and_never_across(
    rigid: Simulation, true_arm: Simulation
) -> None:
    python, own = Stream(rigid, RATE), CompiledStream(Stream(rigid, RATE))
    assert own.remembers_like(CompiledStream(Stream(rigid, RATE)))
    assert not own.remembers_like(CompiledStream(Stream(true_arm, RATE)))
    assert not own.remembers_like(python)
    assert not python.remembers_like(own)


def test_it_is_compiled_once(
    rigid: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    called, compiler = tmp_path / "called", tmp_path / "cc"
    compiler.write_text(f'#!/bin/sh\n[ "$1" = --version ] || echo x >> {called}\nexec cc "$@"\n')
    compiler.chmod(compiler.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("CC", str(compiler))
    for _ in range(2):
        CompiledStream(Stream(rigid, RATE))
    assert called.read_text() == "x\n"


@pytest.mark.parametrize(
    ("compiler", "why"),
    [
        ("no-such-compiler", "no C compiler 'no-such-compiler'"),
        (f"{sys.executable} -c 'import sys; sys.exit(len(sys.argv) > 2 and \"full\")'", "full"),
    ],
)
def test_without_a_compiler_a_stream_stays_what_it_is(
    rigid: Simulation, monkeypatch: pytest.MonkeyPatch, compiler: str, why: str
) -> None:
    monkeypatch.setenv("CC", compiler)
    stream = Stream(rigid, RATE)
    assert fastest(stream) is stream
    with pytest.raises(ConfigError, match=why):
        CompiledStream(stream)


def test_what_has_no_form_in_c_stays_in_python(rigid: Simulation) -> None:
    push = ExternalContact(windows=((1.0, 2.0),), wrench=((1.0, 0.0, 0.0, 0.0, 0.0, 0.0),))
    stream = Stream(Simulation(rigid.robot, (*rigid.effects, push)), RATE)
    assert fastest(stream) is stream


def test_code_that_gives_other_torque_is_not_used(
    rigid: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream = Stream(rigid, RATE)
    wrong = compiled_stream.source_of(stream).replace(
        "*estimates++ = now.time;", "*estimates++ = now.time; now.simulation[1] *= 1.0001;"
    )
    monkeypatch.setattr(compiled_stream, "source_of", lambda _: wrong)
    with pytest.raises(ConfigError, match="torque that differs by"):
        CompiledStream(stream)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="counts what Linux has mapped")
def test_a_stream_that_nobody_uses_any_more_leaves_no_library_behind(rigid: Simulation) -> None:
    def loaded() -> int:
        return Path("/proc/self/maps").read_text().count("limo.so")

    before = loaded()
    one = CompiledStream(Stream(rigid, RATE))
    each = loaded() - before
    two = CompiledStream(Stream(rigid, RATE))
    assert loaded() - before == 2 * each > 0
    del one
    assert loaded() - before == each
    two.init()
    del two
    assert loaded() == before
