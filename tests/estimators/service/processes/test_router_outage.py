"""Eight arms of four drivers through one router: when it is killed, only its absence is lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from processes import ARM, RATE, Answers, Network, served, told, wait_for

from limo_driver.errors import ConnectionLostError
from limo_driver.network.external_torque import ExternalTorque
from limo_driver.network.streaming import Keys, open_session

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from estimators.service.store.store import ModelStore

pytestmark = [pytest.mark.waits, pytest.mark.slow("starts fifteen processes: a minute")]

ARMS = tuple(f"arm{k}" for k in range(8))
DOWN = 7.0  # [s] without a router, longer than silence takes to be told
AGAIN = 9.0  # [s] in which clients have to find it: Zenoh waits up to 4 s between two tries
HERE = Path(__file__).parent
PATHS = f"{HERE}:{HERE.parents[2] / 'limo_driver' / 'network'}"
LISTENER = HERE.parents[3] / "examples" / "embedded" / "zenoh" / "contact_listener.c"
LOST = 0.05  # of the states after an outage, beside twice what a busy machine lost before it

ROUTER = """
import sys, time
from limo_driver.network.streaming import open_session

with open_session(config=sys.argv[1]):
    time.sleep(1e6)
"""

DRIVER = """
import sys, time
sys.path[:0] = sys.argv[1].split(":")
from limo_driver.network.streaming import open_session
from processes import driven

with open_session(config=sys.argv[2]) as session:
    with driven(session, sys.argv[3]), driven(session, sys.argv[4]):
        time.sleep(1e6)
"""

CONSUMER = """
import sys, time
from limo_driver.network.contact_state import ContactListener
from limo_driver.network.external_torque import ExternalListener
from limo_driver.network.streaming import open_session

with open_session(config=sys.argv[1]) as session:
    with ContactListener(session, sys.argv[2]) as contacts:
        with ExternalListener(session, sys.argv[2]) as torques:
            while True:
                print(*(f"{contacts.of(j)} {torques.of(j):.3f}" for j in (1, 2)), flush=True)
                time.sleep(0.1)
"""


@contextmanager
def program(text: str, *arguments: object) -> Generator[subprocess.Popen[bytes]]:
    """Run a program until the block ends, or it is killed."""
    with subprocess.Popen([sys.executable, "-c", text, *map(str, arguments)]) as process:
        try:
            yield process
        finally:
            process.kill()


def test_an_outage_of_the_router_loses_what_falls_into_it_and_is_told(
    store: ModelStore, network: Network, tmp_path: Path
) -> None:
    heard = tmp_path / "heard.jsonl"
    with ExitStack() as running, heard.open("w") as output:
        with program(ROUTER, network.here) as router:
            session = running.enter_context(open_client(network))
            answers = {arm: Answers(session, arm) for arm in ARMS}
            for pair in zip(ARMS[::2], ARMS[1::2], strict=True):
                running.enter_context(program(DRIVER, PATHS, network.there, *pair))
            arms = [f"--arm={arm}={store.root}" for arm in ARMS]
            running.enter_context(served(network, *arms, "--json", stdout=output))
            for own in answers.values():
                own.later(100)
            before = {arm: len(own.sequences) for arm, own in answers.items()}
            router.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        time.sleep(DOWN)
        with program(ROUTER, network.here):
            back = time.monotonic()
            for own in answers.values():
                own.later(200)
            serving = [event for event in told(heard, "serving") if "again" in str(event["text"])]
            assert {event["arm"] for event in told(heard, "silent")} == set(ARMS)
            assert {event["arm"] for event in serving} == set(ARMS)
    for arm, own in answers.items():
        missed = np.diff(own.sequences[20:]) - 1
        assert missed.min() >= 0  # in order, none twice
        outage = missed.argmax()
        assert outage + 20 in range(before[arm] - 20, before[arm] + 100)
        assert missed[outage] <= (back - killed + AGAIN) * RATE
        assert missed[outage + 1 :].mean() <= 2.0 * missed[:outage].mean() + LOST


@contextmanager
def listening(language: str, network: Network, folder: Path) -> Generator[Callable[[], list[str]]]:
    """Run a consumer in its own process; yield what gives the words of its latest line.

    For each joint whether something leans on it, and the external torque.
    """
    output = folder / "heard.txt"
    command = [sys.executable, "-c", CONSUMER, str(network.there), ARM]
    if language == "c":
        endpoint = json.loads(network.there.read_text())["connect"]["endpoints"][0]
        command = [str(compiled_listener(folder)), endpoint, ARM]
    with output.open("w") as lines, subprocess.Popen(command, stdout=lines) as process:
        try:

            def latest() -> list[str]:
                return ["", *output.read_text().split("\n")[:-1]][-1].split()

            yield latest
        finally:
            process.kill()


def compiled_listener(folder: Path) -> Path:
    """Compile the listener in C, if zenoh-pico is here."""
    where = os.environ.get("ZENOH_PICO")
    if where is None:
        pytest.skip("needs the folder of zenoh-pico, built in build/, in ZENOH_PICO")
    program = folder / "listener"
    headers = ["-isystem", f"{where}/build/include", "-isystem", f"{where}/include"]
    library = ["-L", f"{where}/build/lib", "-lzenohpico", "-lpthread"]
    flags = ["-std=c11", "-DZENOH_LINUX", *headers]
    subprocess.run(["cc", *flags, str(LISTENER), "-o", str(program), *library], check=True)
    return program


def knows(words: list[str]) -> bool:
    """Say whether a consumer knows of a joint what leans on it, and how hard.

    On a machine that is busy, states come unevenly, and then the other one may be `outside`.
    """
    joints = zip(words[::2], map(float, words[1::2]), strict=True) if len(words) > 1 else ()
    return any(touch in {"free", "contact"} and np.isfinite(torque) for touch, torque in joints)


@pytest.mark.parametrize("dies", ["router", "service"])
@pytest.mark.parametrize("language", ["python", "c"])
def test_a_consumer_knows_nothing_while_a_part_is_gone_and_again_when_it_is_back(
    store: ModelStore, network: Network, tmp_path: Path, language: str, dies: str
) -> None:
    nothing, service = ["unknown", "nan"] * 2, ("--arm", ARM, "--store", store.root)
    with ExitStack() as running, ExitStack() as dying:
        router = (running if dies == "service" else dying).enter_context(
            program(ROUTER, network.here)
        )
        session = running.enter_context(open_client(network))
        heard: list[ExternalTorque] = []
        keeping = session.declare_subscriber(
            Keys(ARM).known,
            lambda sample: heard.append(ExternalTorque.decode(sample.payload.to_bytes())),
        )
        running.callback(keeping.undeclare)
        latest = running.enter_context(listening(language, network, tmp_path))
        running.enter_context(program(DRIVER, PATHS, network.there, ARM, "other"))
        part = dying if dies == "service" else running
        serving = part.enter_context(served(network, *service))
        wait_for(lambda: knows(latest()))
        (serving if dies == "service" else router).send_signal(signal.SIGKILL)
        dying.close()
        wait_for(lambda: latest() == nothing)
        before = len(heard)
        again = served(network, *service) if dies == "service" else program(ROUTER, network.here)
        with again:
            wait_for(lambda: knows(latest()))
        assert np.isnan(heard[before].torque).all()  # after a gap in the states
        assert heard[before].since_gap < heard[before - 1].since_gap
        assert heard[-1].since_gap > heard[before].since_gap


@contextmanager
def open_client(network: Network) -> Generator:
    """Open a session as soon as the router listens."""
    ends = time.monotonic() + 30.0
    while True:
        try:
            session = open_session(config=network.there)
            break
        except ConnectionLostError:
            assert time.monotonic() < ends
    with session:
        yield session
