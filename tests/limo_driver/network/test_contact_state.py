"""Contact states on the wire: what is none is counted, and silence is not freedom."""

from __future__ import annotations

import json
import math

import pytest
from ports import free_port
from sessions import wait_until

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.contact_state import ContactListener, ContactState, Touch
from limo_driver.network.streaming import Keys, open_session

STATE = ContactState(5, (Touch.FREE, Touch.CONTACT), (1, 2), "3", False, 0.5)
SENT = json.loads(STATE.encode())


def test_what_was_sent_is_read():
    assert ContactState.decode(STATE.encode()) == STATE


@pytest.mark.parametrize(
    "payload",
    [
        b"", b"\xff\xfe", b"null", b"[]", b"{}", b"[" * 100_000, b" " * 70_000,
        *(
            json.dumps({**SENT, **change}).encode()
            for change in (
                {"joints": ["free", "maybe"]}, {"joints": ["free"]}, {"joints": 3},
                {"since_ns": [1]}, {"since_gap": math.nan}, {"since_gap": "1e999"},
                {"stamp_ns": None}, {"stamp_ns": math.inf},
            )
        ),
    ],
)  # fmt: skip
def test_what_is_no_contact_state_is_refused(payload):
    with pytest.raises(WireFormatError, match="no contact state"):
        ContactState.decode(payload)


@pytest.mark.parametrize("patience", [0.0, -1.0, math.inf, math.nan])
def test_patience_that_cannot_be_is_refused(patience):
    with pytest.raises(ConfigError, match="`patience` is"):
        ContactListener(None, "arm", patience)


@pytest.mark.waits
def test_a_listener_hears_one_joint_after_the_other_and_forgets_what_is_old():
    with (
        open_session(listen=f"tcp/127.0.0.1:{free_port()}") as session,
        ContactListener(session, "arm", patience=1e-9) as forgetful,
        ContactListener(session, "arm", patience=1e6) as patient,
    ):
        assert patient.of(1) is Touch.UNKNOWN
        assert patient.latest is None
        session.put(Keys("arm").contact, b"no state")
        session.put(Keys("arm").contact, STATE.encode())
        wait_until(lambda: patient.latest is not None and forgetful.latest is not None)
        assert patient.latest == STATE
        assert patient.malformed == 1
        assert [patient.of(joint) for joint in (0, 1, 2, 3)] == [
            Touch.UNKNOWN, Touch.FREE, Touch.CONTACT, Touch.UNKNOWN,
        ]  # fmt: skip
        assert forgetful.of(2) is Touch.UNKNOWN
