"""A consumer in C reads external torque, and that nobody knows it, as that in Python does."""

from __future__ import annotations

import math
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from c_model import LINES, SANITIZERS, STRICT

from limo_driver.errors import WireFormatError
from limo_driver.network.external_torque import ExternalTorque

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")

HERE = Path(__file__).parent
EXAMPLE = HERE.parents[2] / "examples" / "embedded" / "zenoh"
STAMP = 1_700_000_000_123_456_789
NEWS = ExternalTorque(
    STAMP, np.array([-8.25, math.nan, 0.1]), np.array([0.5, math.nan, 0.3]), "7", False, 12.5
)
PHYSICS = ExternalTorque(5, np.full(32, math.nan), np.full(32, math.nan), "x" * 200, True, 0.0)


@pytest.fixture(scope="module")
def listener(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("external") / "listener"
    sources = ["-I", str(EXAMPLE), str(HERE / "external_driver.c")]
    command = ["gcc", *STRICT, LINES, *SANITIZERS, *sources, "-o", str(program), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


def heard(listener: Path, news: list[bytes]) -> list[list[str]]:
    """Return what the program says after each of the news, a second apart."""
    given = b"".join(
        struct.pack("<dI", float(k), len(payload)) + payload for k, payload in enumerate(news)
    )
    done = subprocess.run([listener], input=given, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return [line.split() for line in done.stdout.decode(errors="replace").split("\n")[:-1]]


def known(news: ExternalTorque | None) -> list[float]:
    """Return of joints 0 to 4 what is known at once, and that nothing is a second later."""
    torque = [] if news is None else news.torque.tolist()
    return [x for now in [math.nan, *torque, *[math.nan] * 4][:5] for x in (now, math.nan)]


def test_what_a_service_says_is_known_until_it_is_silent(listener: Path) -> None:
    first, second = heard(listener, [NEWS.encode(), PHYSICS.encode()])
    for line, news in ((first, NEWS), (second, PHYSICS)):
        assert line[0] == "1"
        np.testing.assert_array_equal(np.array(line[1:11], float), known(news))
    assert first[11:] == [str(STAMP), "12.5", "0", "0.5", "7"]
    assert second[11:] == ["5", "0", "1", "nan", "x" * 63]


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        NEWS.encode()[:23],
        NEWS.encode()[:71],
        b"\x02" + NEWS.encode()[1:],
        NEWS.encode()[:2] + b"\x00\x00" + NEWS.encode()[4:],
        NEWS.encode()[:2] + b"\x21\x00" + NEWS.encode()[4:] + bytes(1000),
        NEWS.encode()[:16] + struct.pack("<d", math.inf) + NEWS.encode()[24:],
    ],
)
def test_what_is_no_news_changes_nothing(listener: Path, payload: bytes) -> None:
    before, whole, after = heard(listener, [payload, NEWS.encode(), payload])
    assert (before[0], whole[0], after[0]) == ("0", "1", "0")
    np.testing.assert_array_equal(np.array(before[1:11], float), known(None))
    np.testing.assert_array_equal(np.array(after[1:11], float), known(None))
    assert after[11:] == whole[11:]


def test_bytes_that_were_hit_are_read_as_in_python_or_refused(listener: Path) -> None:
    rng, whole = np.random.default_rng(0), np.frombuffer(NEWS.encode(), np.uint8)
    news = []
    for _ in range(2000):
        hit = whole.copy()[: rng.choice([whole.size, rng.integers(1, whole.size)])]
        hit[rng.integers(hit.size, size=rng.integers(0, 3))] = rng.integers(256)
        news.append(hit.tobytes())
    taken = 0
    for payload, line in zip(news, heard(listener, news), strict=True):
        try:
            expected = ExternalTorque.decode(payload)
        except WireFormatError:  # C takes a version that is no UTF-8
            continue
        if expected.torque.size <= 32:
            assert line[0] == "1"
            np.testing.assert_array_equal(np.array(line[1:11], float), known(expected))
            taken += 1
    assert taken > 500
