"""Roles on a network of real sessions: who is let in, and what arrives of what each one sends."""

import json
import stat
import sys
from contextlib import ExitStack

import numpy as np
import pytest
import zenoh
from ports import free_port
from sessions import wait_until
from typer.testing import CliRunner

from limo_driver.app.cli.secure import command
from limo_driver.errors import ConfigError, ConnectionLostError, MissingPackageError
from limo_driver.network.claims import Witness, claim
from limo_driver.network.config import read_config, require_passage
from limo_driver.network.messages import decode_joint_state
from limo_driver.network.ros import RosTopic
from limo_driver.network.streaming import (
    JointStatePublisher,
    Keys,
    declare_history,
    follow_history,
    open_session,
)
from limo_driver.network.trust import write_trust
from limo_driver.network.trust.roles import ROLES, Host
from limo_driver.types import JointState

pytestmark = pytest.mark.waits

KEYS = Keys("arm")


@pytest.fixture(scope="module")
def trust(tmp_path_factory):
    folder = tmp_path_factory.mktemp("network") / "trust"
    hosts = {"driver": Host("127.0.0.1", free_port()), "service": Host("localhost", free_port())}
    return write_trust(folder, hosts)


@pytest.fixture(scope="module")
def network(trust):
    """A session of each role, linked as configured."""
    with ExitStack() as open_:
        sessions = {
            name: open_.enter_context(open_session(config=path))
            for name, path in trust.configurations.items()
        }
        links = {"driver": 3, "service": 3, "operator": 2, "viewer": 2}
        wait_until(lambda: all(len(sessions[n].info.peers_zid()) == k for n, k in links.items()))
        yield sessions


class Inbox:
    """What a role hears under a key."""

    def __init__(self, session, key):
        self.heard = []
        self._subscriber = session.declare_subscriber(
            key, lambda sample: self.heard.append(sample.payload.to_string())
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._subscriber.undeclare()


def put_until_heard(sender, key, inbox, text):
    def heard():
        sender.put(key, text)
        return text in inbox.heard

    wait_until(heard)


class TestWhatArrives:
    @pytest.mark.parametrize(
        ("sender", "key", "hearer"),
        [
            ("driver", KEYS.joints, "service"),
            ("driver", KEYS.joints, "viewer"),
            ("service", KEYS.estimate, "viewer"),
            ("service", KEYS.external, "driver"),
            ("service", KEYS.known, "driver"),
            ("service", KEYS.contact, "driver"),
            ("service", KEYS.event, "operator"),
            ("operator", "limo/arm/command/joints", "driver"),
            ("operator", "limo/arm/command/joints", "service"),
        ],
    )
    def test_what_a_role_may_publish(self, network, sender, key, hearer):
        with Inbox(network[hearer], "limo/**") as inbox:
            put_until_heard(network[sender], key, inbox, "allowed")

    @pytest.mark.parametrize(
        ("sender", "key", "hearer"),
        [
            ("viewer", "limo/arm/command/joints", "driver"),
            ("viewer", "limo/*/command/*", "driver"),
            ("viewer", "limo/**", "driver"),
            ("viewer", KEYS.joints, "service"),
            ("viewer", KEYS.event, "service"),
            ("service", "limo/arm/command/joints", "driver"),
            ("service", KEYS.joints, "driver"),
            ("operator", KEYS.joints, "service"),
            ("driver", KEYS.estimate, "service"),
            ("driver", KEYS.status("service"), "service"),
        ],
    )
    def test_what_it_may_not_never_arrives(self, network, sender, key, hearer):
        by_right = {"driver": KEYS.joints, "service": KEYS.estimate}
        witness = "operator" if sender == "viewer" else sender
        allowed = by_right.get(witness, "limo/arm/command/joints")
        with Inbox(network[hearer], "limo/**") as inbox:
            put_until_heard(network[witness], allowed, inbox, f"allowed: {key}")  # it is subscribed
            for k in range(5):
                network[sender].put(key, "forbidden")
                network[sender].delete(key)
                put_until_heard(network[witness], allowed, inbox, f"allowed after {k} of {key}")
            # What an earlier test put more than once may still have come.
            assert all(text.startswith("allowed") for text in inbox.heard)

    def test_states_reach_the_service_over_tls(self, network):
        got = []

        def hear(sample):
            if sample.attachment:  # no text that an earlier test put more than once
                got.append(sample)

        subscriber = network["service"].declare_subscriber(KEYS.joints, hear)
        values = np.array([0.1, -0.2])
        with JointStatePublisher(network["driver"], "arm", ["a", "b"]) as publisher:

            def arrived():
                publisher.publish(JointState(0.0, values, values, 3 * values, 0))
                return got

            wait_until(arrived)
        subscriber.undeclare()
        np.testing.assert_array_equal(
            decode_joint_state(got[0].payload.to_bytes()).torque, 3 * values
        )

    def test_who_comes_late_hears_events(self, network):
        publisher = declare_history(network["service"], Keys("late").event)
        publisher.put("told before")
        heard = []
        subscriber = follow_history(
            network["viewer"],
            Keys("late").event,
            lambda sample: heard.append(sample.payload.to_string()),
        )
        wait_until(lambda: heard == ["told before"])
        subscriber.undeclare()
        publisher.undeclare()


class TestModels:
    @pytest.fixture
    def asked(self, network):
        asked = []

        def answer(query: zenoh.Query) -> None:
            asked.append(str(query.key_expr))
            query.reply(query.key_expr, b"done")

        queryable = network["service"].declare_queryable(KEYS.model("*"), answer)
        wait_until(lambda: ask(network["operator"], KEYS.model("index")) == ["done"])
        asked.clear()
        yield asked
        queryable.undeclare()

    def test_an_operator_may_change_them(self, network, asked):
        assert ask(network["operator"], KEYS.model("promote")) == ["done"]
        assert asked == [KEYS.model("promote")]

    @pytest.mark.parametrize("role", ["viewer", "driver"])
    @pytest.mark.parametrize(
        "key",
        [KEYS.model("promote"), KEYS.model("load"), KEYS.model("rollback"), "limo/*/model/*", "**"],
    )
    def test_others_may_not(self, network, asked, role, key):
        seen = {'{"bystander": []}'} if key == "**" else set()  # each session says whom it sees
        assert set(ask(network[role], key)) <= seen
        assert asked == []

    @pytest.mark.usefixtures("asked")
    def test_everyone_may_list_them(self, network):
        assert ask(network["viewer"], KEYS.model("index")) == ["done"]

    @pytest.mark.usefixtures("asked")
    def test_only_the_service_answers(self, network):
        queryable = network["driver"].declare_queryable(
            KEYS.model("promote"), lambda query: query.reply(query.key_expr, b"forged")
        )
        assert ask(network["operator"], KEYS.model("promote")) == ["done"]
        queryable.undeclare()

    def test_only_a_driver_is_alive_as_one(self, network):
        true = network["driver"].liveliness().declare_token(Keys("a").alive("driver", "1"))
        forged = network["viewer"].liveliness().declare_token(Keys("b").alive("driver", "1"))

        def alive():
            replies = network["service"].liveliness().get("limo/*/alive/driver/*", timeout=60.0)
            return [str(reply.ok.key_expr) for reply in replies]

        wait_until(lambda: alive() == ["limo/a/alive/driver/1"])
        assert alive() == ["limo/a/alive/driver/1"]
        true.undeclare()
        forged.undeclare()

    def test_a_second_service_of_a_name_is_refused_through_the_driver(self, network, trust):
        """The ends of the star that is written here do not see each other."""
        first = trust.configurations["service"]
        [[own]] = json.loads(read_config(first).get_json("listen/endpoints")).values()
        text = first.read_text()
        another = own.rpartition(":")[0] + f":{free_port()}"
        second = first.with_name("second.json5")
        second.write_text(text.replace(own, another))
        try:
            with Witness(network["driver"]), open_session(config=second) as session:
                wait_until(lambda: list(session.info.peers_zid()))
                token = claim(network["service"], Keys("star"), "service")
                with pytest.raises(ConfigError, match="another service of an arm called 'star'"):
                    claim(session, Keys("star"), "service")
                token.undeclare()
        finally:
            second.unlink()


def ask(session, key):
    return [reply.ok.payload.to_string() for reply in session.get(key, timeout=60.0) if reply.ok]


@pytest.mark.usefixtures("network")
class TestStrangers:
    """Sessions that say at once when they are refused."""

    def link(self, trust, role, changes, seconds=120):
        config = read_config(trust.configurations[role])
        for key, value in changes.items():
            config.insert_json5(key, json.dumps(value))
        config.insert_json5("connect/timeout_ms", str(1000 * seconds))
        config.insert_json5("connect/exit_on_failure", "true")
        return zenoh.open(config)

    def refused(self, trust, changes):
        """Try for two seconds: who is refused tries again."""
        with pytest.raises(zenoh.ZError):
            self.link(trust, "viewer", changes, seconds=2)

    def test_one_that_changes_nothing_is_let_in(self, trust):
        with self.link(trust, "viewer", {}) as session:
            wait_until(lambda: len(session.info.peers_zid()) == 2)

    def test_without_a_certificate(self, trust):
        nothing = {
            "transport/link/tls/connect_certificate": None,
            "transport/link/tls/connect_private_key": None,
            "transport/link/tls/enable_mtls": False,
        }
        self.refused(trust, nothing)

    @pytest.mark.slow("tries for two seconds, and waits")
    def test_with_a_certificate_of_another_authority(self, trust, tmp_path):
        hosts = {"driver": Host("127.0.0.1", 1), "service": Host("localhost", 2)}
        other = write_trust(tmp_path / "other", hosts).path / "viewer"
        theirs = {
            "transport/link/tls/connect_certificate": str(other / "certificate.pem"),
            "transport/link/tls/connect_private_key": str(other / "key.pem"),
        }
        self.refused(trust, theirs)

    def test_with_a_wrong_password(self, trust):
        self.refused(trust, {"transport/auth/usrpwd/password": "guessed"})

    @pytest.mark.slow("tries for two seconds, and waits")
    def test_without_a_password(self, trust):
        nobody = {"transport/auth/usrpwd/user": None, "transport/auth/usrpwd/password": None}
        self.refused(trust, nobody)

    @pytest.mark.slow("tries for two seconds, and waits")
    def test_in_the_clear(self, trust):
        endpoint = json.loads(
            read_config(trust.configurations["viewer"]).get_json("connect/endpoints")
        )["peer"][0].replace("tls/", "tcp/")
        config = zenoh.Config()
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("connect/timeout_ms", "2000")
        config.insert_json5("connect/exit_on_failure", "true")
        config.insert_json5("scouting/multicast/enabled", "false")
        with pytest.raises(zenoh.ZError):
            zenoh.open(config)

    def test_a_stolen_password_without_the_certificate_lets_nothing_through(self, network, trust):
        operator = read_config(trust.configurations["operator"])
        stolen = {
            f"transport/auth/usrpwd/{key}": json.loads(
                operator.get_json(f"transport/auth/usrpwd/{key}")
            )
            for key in ("user", "password")
        }
        with (
            self.link(trust, "viewer", stolen) as session,
            Inbox(network["driver"], "limo/**") as inbox,
        ):
            key = "limo/arm/command/joints"
            put_until_heard(network["operator"], key, inbox, "allowed: stolen")  # it is subscribed
            for k in range(5):
                session.put(key, "forbidden")
                put_until_heard(network["operator"], key, inbox, f"allowed after {k} stolen")
            assert all(text.startswith("allowed") for text in inbox.heard)

    def test_an_endpoint_in_the_clear_is_refused_on_the_command_line(self, trust):
        with pytest.raises((ConfigError, ConnectionLostError), match="tcp/127"):
            open_session(
                listen=[f"tcp/127.0.0.1:{free_port()}"], config=trust.configurations["viewer"]
            )


class TestPassage:
    def test_of_what_roles_do_not_send_is_refused(self, trust):
        for role, topic, flow in (
            ("driver", RosTopic().key, "egress"),
            ("service", RosTopic().key_of_any_hash, "ingress"),
        ):
            with pytest.raises(ConfigError, match="`ros_domain` would reach nobody"):
                require_passage(trust.configurations[role], topic, flow, "`ros_domain`")
            require_passage(trust.configurations[role], KEYS.joints, flow, "--stream")

    @pytest.mark.parametrize(
        "access",
        [
            {},
            {
                "enabled": False,
                "default_permission": "deny",
                "rules": [],
                "subjects": [],
                "policies": [],
            },
            {
                "enabled": True,
                "default_permission": "allow",
                "rules": [],
                "subjects": [],
                "policies": [],
            },
            {
                "enabled": True,
                "default_permission": "deny",
                "rules": [
                    {"id": "ros", "permission": "allow", "messages": ["put"], "key_exprs": ["0/**"]}
                ],
                "subjects": [{"id": "all"}],
                "policies": [{"rules": ["ros"], "subjects": ["all"]}],
            },
        ],
    )
    def test_is_free_where_nothing_forbids_it(self, access, tmp_path):
        path = tmp_path / "zenoh.json5"
        path.write_text(json.dumps({"access_control": access} if access else {}))
        require_passage(path, RosTopic().key, "egress", "--ros")

    def test_is_asked_for_by_the_command(self, trust, limo, tmp_path):
        done = limo(
            "serve",
            "--arm",
            "arm",
            "--model",
            tmp_path,
            "--ros",
            "joint_states",
            "--zenoh-config",
            trust.configurations["service"],
        )
        assert done.returncode != 0
        assert "--ros would reach nobody" in done.stderr.replace("\n", " ")
        assert "Traceback" not in done.stderr


class TestFolder:
    HOSTS = {"driver": Host("robot", 7447), "service": Host("robot", 7448)}  # noqa: RUF012

    def test_is_readable_by_its_owner_alone(self, trust):
        files = [path for path in trust.path.rglob("*") if path.is_file()]
        assert len(files) == 2 + 4 * 4 + 2
        assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o600}

    def test_a_password_is_only_where_it_is_needed(self, trust):
        password = json.loads(
            read_config(trust.configurations["viewer"]).get_json("transport/auth/usrpwd/password")
        )
        holders = {
            str(path.relative_to(trust.path))
            for path in trust.path.rglob("*")
            if path.is_file() and password in path.read_text()
        }
        assert holders == {"viewer/zenoh.json5", "driver/users.txt", "service/users.txt"}

    def test_nothing_is_written_over_without_force(self, tmp_path):
        write_trust(tmp_path, self.HOSTS)
        before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        with pytest.raises(ConfigError, match=r"certificate\.pem: is there already.*`force`"):
            write_trust(tmp_path, self.HOSTS)
        assert {path: path.read_bytes() for path in before} == before
        write_trust(tmp_path, self.HOSTS, force=True)
        assert all(path.read_bytes() != content for path, content in before.items()
                   if path.name == "key.pem")  # fmt: skip

    @pytest.mark.parametrize("planted", ["folder", "role", "key"])
    def test_links_that_somebody_planted_lead_no_key_away(self, planted, tmp_path):
        out, elsewhere = tmp_path / "trust", tmp_path / "elsewhere"
        elsewhere.mkdir()
        if planted == "folder":
            out.symlink_to(elsewhere)
        elif planted == "role":
            out.mkdir()
            (out / "driver").symlink_to(elsewhere)
        else:
            (out / "driver").mkdir(parents=True)
            (elsewhere / "taken").write_text("theirs")
            (out / "driver" / "key.pem").symlink_to(elsewhere / "taken")
        if planted == "key":
            write_trust(out, self.HOSTS, force=True)
            assert (elsewhere / "taken").read_text() == "theirs"
            assert not (out / "driver" / "key.pem").is_symlink()
        else:
            with pytest.raises(ConfigError, match="is a link, expected a folder"):
                write_trust(out, self.HOSTS, force=True)
            assert not list(elsewhere.iterdir())

    def test_a_role_can_be_moved(self, trust, tmp_path):
        moved = tmp_path / "elsewhere"
        (trust.path / "viewer").rename(moved)
        try:
            config = read_config(moved / "zenoh.json5")
        finally:
            moved.rename(trust.path / "viewer")
        assert json.loads(config.get_json("transport/link/tls/connect_private_key")) == str(
            moved / "key.pem"
        )

    def test_a_file_that_is_missing_is_named(self, tmp_path):
        write_trust(tmp_path, self.HOSTS)
        (tmp_path / "driver" / "users.txt").unlink()
        with pytest.raises(ConfigError, match=r"zenoh\.json5: .*dictionary_file is users\.txt"):
            open_session(config=tmp_path / "driver" / "zenoh.json5")

    def test_one_address_cannot_be_two_endpoints(self, tmp_path):
        same = {"driver": Host("robot", 7447), "service": Host("robot", 7447)}
        with pytest.raises(ConfigError, match="both at tls/robot:7447"):
            write_trust(tmp_path, same)

    @pytest.mark.parametrize("days", [0, 36501, 10**12])
    def test_certificates_have_to_be_valid_for_some_time(self, tmp_path, days):
        with pytest.raises(ConfigError, match=f"valid for {days} days, expected 1 to 36500"):
            write_trust(tmp_path, self.HOSTS, days=days)

    def test_says_what_to_install(self, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "cryptography", None)
        with pytest.raises(MissingPackageError, match="pip install 'cryptography"):
            write_trust(tmp_path, self.HOSTS)

    def test_every_role_has_a_configuration_that_zenoh_reads(self, trust):
        assert set(trust.configurations) == set(ROLES)
        for path in trust.configurations.values():
            assert json.loads(read_config(path).get_json("access_control/enabled")) is True


class TestHosts:
    @pytest.mark.parametrize(
        ("text", "endpoint"),
        [
            ("robot.local", "tls/robot.local:7447"),
            ("10.0.0.2:7500", "tls/10.0.0.2:7500"),
            ("[fe80::1]:7500", "tls/[fe80::1]:7500"),
        ],
    )
    def test_are_read(self, text, endpoint):
        assert Host.parse(text, 7447).endpoint == endpoint

    @pytest.mark.parametrize("text", ["", "a b", "robot:", "robot:0", "robot:70000", "tls/robot"])
    def test_are_refused(self, text):
        with pytest.raises(ConfigError, match="expected HOST or HOST:PORT"):
            Host.parse(text, 7447)


def test_the_command_says_what_it_wrote(tmp_path):
    import typer

    app = typer.Typer()
    app.command()(command)
    given = ["--out", str(tmp_path / "trust"), "--driver", "robot", "--service", "10.0.0.3:7500"]
    result = CliRunner().invoke(app, given)
    assert result.exit_code == 0, result.output
    assert f"{tmp_path}/trust/viewer/zenoh.json5: only reads" in result.output
    text = (tmp_path / "trust" / "viewer" / "zenoh.json5").read_text()
    assert '["tls/robot:7447", "tls/10.0.0.3:7500"]' in text
