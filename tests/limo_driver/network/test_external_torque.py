"""External torque as far as it is known, on the wire: silence and nonsense are no torque."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from ports import free_port
from sessions import wait_until

from limo_driver.errors import WireFormatError
from limo_driver.network.external_torque import ExternalListener, ExternalTorque
from limo_driver.network.streaming import Keys, open_session

NEWS = ExternalTorque(5, np.array([1.5, math.nan]), np.array([0.1, math.nan]), "3 ü", True, 0.5)
SENT = NEWS.encode()


def same(one: ExternalTorque, other: ExternalTorque) -> bool:
    return one.encode() == other.encode()


def test_what_was_sent_is_read():
    got = ExternalTorque.decode(SENT)
    assert same(got, NEWS)
    assert (got.stamp_ns, got.model, got.physics_only, got.since_gap) == (5, "3 ü", True, 0.5)
    np.testing.assert_array_equal(got.torque, NEWS.torque)
    np.testing.assert_array_equal(got.std, NEWS.std)


def test_flags_of_later_versions_change_nothing():
    assert same(ExternalTorque.decode(SENT[:1] + b"\xff" + SENT[2:]), NEWS)


@pytest.mark.parametrize(
    ("payload", "why"),
    [
        (b"", "in 0 bytes"),
        (SENT[:23], "in 23 bytes"),
        (b"\x02" + SENT[1:], "version 2, expected 1"),
        (SENT[:2] + b"\x00\x00" + SENT[4:24], "0 joints"),
        (SENT[:2] + b"\x03\x00" + SENT[4:], "no external torque in"),
        (SENT[:16] + struct.pack("<d", math.nan) + SENT[24:], "nan s since"),
        (SENT[:16] + struct.pack("<d", -1.0) + SENT[24:], "-1.0 s since"),
        (SENT[:-1], "no external torque"),
    ],
)
def test_what_is_no_external_torque_is_refused(payload, why):
    with pytest.raises(WireFormatError, match=why):
        ExternalTorque.decode(payload)


@pytest.mark.waits
def test_a_listener_knows_only_what_is_known_and_new():
    with (
        open_session(listen=f"tcp/127.0.0.1:{free_port()}") as session,
        ExternalListener(session, "arm", patience=1e-9) as forgetful,
        ExternalListener(session, "arm", patience=1e6) as patient,
    ):
        assert math.isnan(patient.of(1))
        session.put(Keys("arm").known, b"no torque")
        session.put(Keys("arm").known, SENT)
        wait_until(lambda: patient.latest is not None and forgetful.latest is not None)
        assert patient.malformed == 1
        assert patient.of(1) == 1.5
        assert all(math.isnan(patient.of(joint)) for joint in (0, 2, 3))
        assert math.isnan(forgetful.of(1))
        assert same(forgetful.latest, NEWS)
