"""Names are claimed where nobody sees everybody: a star of sessions, each a process of its own."""

import json
import subprocess
import sys
import threading

import pytest
import zenoh
from lanes import sampled
from ports import free_port
from sessions import sessions_of_two, wait_until

from limo_driver.errors import ConfigError
from limo_driver.network import claims
from limo_driver.network.streaming import (
    JointStatePublisher,
    Keys,
    Presence,
    is_alive,
    open_session,
)

pytestmark = pytest.mark.waits

CLAIM = """
import sys
from limo_driver.errors import ConfigError
from limo_driver.network.streaming import Presence
with Presence([sys.argv[3]], sys.argv[1], config=sys.argv[2]) as presence:
    try:
        presence.session()
    except ConfigError as error:
        print("refused:", error, flush=True)
    else:
        print("claimed", flush=True)
        sys.stdin.readline()
"""


def written(folder, name, **endpoints):
    path = folder / f"{name}.json5"
    alone = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    path.write_text(json.dumps(endpoints | {"scouting": alone}))
    return path


@pytest.fixture
def star(tmp_path):
    """Configurations of a hub and of two that reach nobody but it."""
    hub = {"endpoints": [f"tcp/127.0.0.1:{free_port()}"]}
    ends = [{"endpoints": [f"tcp/127.0.0.1:{free_port()}"]} for _ in range(2)]
    return written(tmp_path, "hub", listen=hub), *(
        written(tmp_path, f"end{k}", listen=own, connect=hub) for k, own in enumerate(ends)
    )


def claimed(part, config, arm="arm"):
    return subprocess.Popen(
        [sys.executable, "-c", CLAIM, part, str(config), arm],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


@sampled(
    ("centre", "part", "arm"),
    [
        ("driver", "service", "arm"),
        ("service", "driver", "arm"),
        pytest.param("service", "driver", "seen", id="an arm called as a key"),
    ],
    "starts three processes each",
)
def test_a_second_one_in_a_star_is_refused_until_the_first_has_gone(star, centre, part, arm):
    hub, *ends = star
    with Presence([arm], centre, config=hub) as middle:
        middle.session()
        first = claimed(part, ends[0], arm)
        with first:
            assert first.stdout.readline() == "claimed\n"
            with claimed(part, ends[1], arm) as second:
                assert f"another {part} of an arm called '{arm}'" in second.stdout.readline()
            first.communicate("\n")
        with claimed(part, ends[1], arm) as again:
            assert again.stdout.readline() == "claimed\n"
            again.communicate("\n")


def seen(session, part):
    """Return what those around a session answer who are asked whom they see."""
    every = {"target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}
    replies = session.get(Keys("arm").seen(part), timeout=60.0, **every)
    return [json.loads(reply.ok.payload.to_bytes()) for reply in replies]


@pytest.fixture
def ends(star):
    """Sessions at the ends of the star, once something is its hub."""
    opened = []

    def open_ends():
        opened.extend(open_session(config=end) for end in star[1:])
        return opened

    yield open_ends
    for session in opened:
        session.close()


@pytest.mark.parametrize("part", ["driver", "service"])
def test_a_second_one_is_refused_where_the_hub_is_neither_driver_nor_service(star, ends, part):
    """But any session of limo, such as one that watches."""
    with open_session(config=star[0]):
        first, second = ends()
        token = claims.claim(first, Keys("arm"), part)
        with pytest.raises(ConfigError, match=f"another {part} of an arm called 'arm' is on the"):
            claims.claim(second, Keys("arm"), part)
        token.undeclare()
        wait_until(
            lambda: seen(second, part) and not any(t["bystander"] for t in seen(second, part))
        )
        claims.claim(second, Keys("arm"), part).undeclare()


def test_nobody_is_had_behind_a_hub_that_is_not_limos(star, ends, monkeypatch):
    monkeypatch.setattr(claims, "PATIENCE", 1.0)
    with zenoh.open(zenoh.Config.from_file(str(star[0]))) as hub:
        for session in ends():
            told = f"linked to a peer that does not say whom it sees .*{hub.zid()}.*router"
            with pytest.raises(ConfigError, match=told):
                claims.claim(session, Keys("arm"), "driver")


@pytest.mark.parametrize("who", ["who is linked to it", "a router"])
def test_others_that_are_not_limos_stop_nobody(star, who, monkeypatch):
    """Those that reach a driver, and routers, which pass tokens on."""
    monkeypatch.setattr(claims, "PATIENCE", 1.0)
    config = zenoh.Config.from_file(str(star[0 if who == "a router" else 1]))
    if who == "a router":
        config.insert_json5("mode", '"router"')
        with zenoh.open(config), open_session(config=star[1]) as session:
            claims.claim(session, Keys("arm"), "driver").undeclare()
        return
    with open_session(config=star[0]) as session, zenoh.open(config) as other:
        wait_until(lambda: str(other.zid()) in map(str, session.info.peers_zid()))
        claims.claim(session, Keys("arm"), "driver").undeclare()


def test_a_session_that_is_closed_leaves_no_thread_behind(star):
    before = set(threading.enumerate())
    open_session(config=star[0]).close()
    for thread in set(threading.enumerate()) - before:
        thread.join(60.0)
        assert not thread.is_alive()


@pytest.mark.slow("starts two processes")
def test_of_two_that_begin_together_at_the_ends_of_a_star_one_stays(star):
    hub, *ends = star
    with Presence(["other"], "driver", config=hub) as middle:
        middle.session()
        both = [claimed("service", end) for end in ends]
        said = sorted(each.stdout.readline() for each in both)
        for each in both:
            each.communicate("\n")
    assert said[0] == "claimed\n"
    assert said[1].startswith("refused:")


@pytest.mark.slow("waits in vain")
def test_no_name_is_had_while_somebody_does_not_tell_whom_it_sees(tmp_path, monkeypatch):
    """As a witness that is flooded with queries, whose ring drops ours."""
    monkeypatch.setattr(claims, "PATIENCE", 1.0)
    with sessions_of_two(tmp_path) as (here, there):
        token = there.liveliness().declare_token(f"limo/other/alive/driver/1-{there.zid()}")
        wait_until(lambda: is_alive(here, "limo/other/alive/driver/*"))
        silent = f"cannot be told: 1 of the drivers and services .* {there.zid()}"
        with pytest.raises(ConfigError, match=silent):
            claims.claim(here, Keys("arm"), "service")
        assert not is_alive(there, "limo/arm/alive/service/*")
        with claims.Witness(there):
            claims.claim(here, Keys("arm"), "service").undeclare()
        token.undeclare()


@pytest.mark.slow("starts a process")
def test_a_driver_that_publishes_is_a_hub_too(star):
    hub, end, _ = star
    with (
        open_session(config=hub) as session,
        JointStatePublisher(session, "other", ["a"]),
        claimed("service", end) as first,
    ):
        assert first.stdout.readline() == "claimed\n"
        wait_until(
            lambda: any(isinstance(told, list) and told for told in seen(session, "service"))
        )
        told = [each for each in seen(session, "service") if isinstance(each, list)]
        assert {len(tokens) for tokens in told} == {1}
        assert all(is_alive(session, tokens[0]) for tokens in told)
        first.communicate("\n")
