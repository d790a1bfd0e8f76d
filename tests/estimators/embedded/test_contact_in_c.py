"""A consumer in C tells no contact from not knowing, as that in Python does."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from c_model import LINES, SANITIZERS, STRICT

from limo_driver.errors import WireFormatError
from limo_driver.network.contact_state import ContactState, Touch

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")

HERE = Path(__file__).parent
EXAMPLE = HERE.parents[2] / "examples" / "embedded" / "zenoh"
ORDER = {Touch.UNKNOWN: 0, Touch.FREE: 1, Touch.CONTACT: 2}
STATE = ContactState(
    1_700_000_000_000_000_000,
    (Touch.FREE, Touch.CONTACT, Touch.UNKNOWN, Touch.FREE),
    (1, 2, 3, 4),
    'a "joints": ["free"] \\ ü',
    physics_only=False,
    since_gap=12.5,
)


@pytest.fixture(scope="module")
def listener(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("contact") / "listener"
    sources = ["-I", str(EXAMPLE), str(HERE / "contact_driver.c")]
    command = ["gcc", *STRICT, LINES, *SANITIZERS, *sources, "-o", str(program)]
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
    return [line.split() for line in done.stdout.decode().splitlines()]


def known(joints: tuple[Touch, ...]) -> list[str]:
    """Return of joints 0 to 8 what is known at once, and that nothing is a second later."""
    numbers = [0, *map(ORDER.__getitem__, joints), *[0] * 8][:9]
    return [f"{number}0" for number in numbers]


def test_what_a_service_says_is_known_until_it_is_silent(listener: Path) -> None:
    other = replace(STATE, joints=(Touch.UNKNOWN,) * 7, since_ns=(0,) * 7)
    spaced = json.dumps(json.loads(STATE.encode()), indent=2).encode()
    shuffled = json.dumps(dict(reversed(json.loads(STATE.encode()).items()))).encode()
    news = [STATE.encode(), other.encode(), spaced, shuffled]
    expected = [STATE, other, STATE, STATE]
    assert heard(listener, news) == [["1", *known(state.joints)] for state in expected]


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"{",
        b"{}",
        b"[]",
        b'{"joints": []}',
        b'{"joints": ["free"',
        b'{"joints": ["loose"]}',
        b'{"joints": [1]}',
        b'{"joints": ["free"], "model": "1}',
        b'{"model": {"joints": ["free"]}}',
        b'{"joints": [' + b", ".join([b'"free"'] * 33) + b"]}",
    ],
)
def test_what_is_no_news_changes_nothing(listener: Path, payload: bytes) -> None:
    found = heard(listener, [payload, STATE.encode(), payload])
    assert found[0] == ["0", *known(())]
    assert found[1] == ["1", *known(STATE.joints)]
    assert found[2] == ["0", *["00"] * 9]  # a second later, nothing is known of before


def test_bytes_that_were_hit_are_read_as_in_python_or_refused(listener: Path) -> None:
    rng, whole = np.random.default_rng(0), np.frombuffer(STATE.encode(), np.uint8)
    news = []
    for _ in range(2000):
        hit = whole.copy()[: rng.choice([whole.size, rng.integers(1, whole.size)])]
        hit[rng.integers(hit.size, size=rng.integers(0, 3))] = rng.integers(256)
        news.append(hit.tobytes())
    taken = 0
    for payload, (ok, *touches) in zip(news, heard(listener, news), strict=True):
        try:
            expected = ContactState.decode(payload)
        except WireFormatError:  # C looks at the joints alone
            continue
        assert (ok, touches) == ("1", known(expected.joints))
        taken += 1
    assert taken > 20


def test_the_listener_compiles_against_what_it_uses_of_zenoh() -> None:
    source = str(EXAMPLE / "contact_listener.c")
    command = ["gcc", *STRICT, "-fsyntax-only", "-I", str(HERE / "stubs"), source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
