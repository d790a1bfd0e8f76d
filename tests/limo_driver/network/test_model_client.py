"""What is asked of a service that has its name already, but cannot answer yet."""

import threading

import pytest
from sessions import PATIENCE, wait_until

from limo_driver.errors import ConnectionLostError
from limo_driver.network import readiness
from limo_driver.network.readiness import ModelClient
from limo_driver.network.streaming import Keys, is_alive, to_json

pytestmark = pytest.mark.waits

KEYS = Keys("arm")


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    monkeypatch.setattr(readiness, "STARTING", PATIENCE)


@pytest.fixture
def named(two_sessions):
    """A session that sees a service's name, and the session which that is in."""
    service, asking = two_sessions
    token = service.liveliness().declare_token(KEYS.alive("service", "1"))
    wait_until(lambda: is_alive(asking, KEYS.alive("service")))
    yield asking, service
    token.undeclare()


def test_the_answer_is_waited_for(named):
    asking, service = named

    def answer(query):
        query.reply(KEYS.model("index"), to_json({"arm": "arm"}))

    answering = []
    start = threading.Timer(
        0.5, lambda: answering.append(service.declare_queryable(KEYS.model("index"), answer))
    )
    start.start()
    assert ModelClient(asking, "arm").index() == {"arm": "arm"}
    start.join()
    answering[0].undeclare()


def test_it_is_said_that_nobody_answers(named, monkeypatch):
    monkeypatch.setattr(readiness, "STARTING", 0.3)
    with pytest.raises(
        ConnectionLostError, match=r"nobody answered limo/arm/model/index for 0\.3 s"
    ):
        ModelClient(named[0], "arm").index()


def test_it_is_said_that_there_is_none(two_sessions, monkeypatch):
    monkeypatch.setattr(readiness, "APPEARING", 0.2)
    with pytest.raises(ConnectionLostError, match="no service of arm 'arm' is on the network"):
        ModelClient(two_sessions[1], "arm").index()
