"""Messages that are no joint states of an arm, of every kind, from a seed."""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.network.messages import Attachment, JointStateCodec

if TYPE_CHECKING:
    from random import Random

NAMES = ("shoulder", "elbow")
START = 1_700_000_000_000_000_000  # [ns]
PERIOD = 10_000_000  # [ns]
CODEC = JointStateCodec(NAMES, "arm")
NOTHING = np.empty(0)

Message = tuple[bytes, bytes]


def state(t: int) -> Message:
    """Return the joint state of cycle t, and its attachment."""
    position = np.array([np.sin(0.01 * t), np.cos(0.01 * t)])
    payload = CODEC.encode(START + t * PERIOD, position, 0 * position, position)
    return payload, Attachment(t, t * PERIOD).encode()


def _values(random: Random, wrong: tuple[float, ...], field: int, t: int) -> Message:
    arrays = [np.zeros(2) for _ in range(3)]
    arrays[field][random.randrange(2)] = random.choice(wrong)
    return CODEC.encode(START + t * PERIOD, *arrays), state(t)[1]


def _of_joints(random: Random, t: int) -> Message:
    names = random.choice(
        [("elbow", "shoulder"), ("shoulder",), (*NAMES, "wrist"), ("a", "b"), (), ("", "\t")]
    )
    zeros = np.zeros(len(names))
    return JointStateCodec(names, "arm").encode(START + t * PERIOD, zeros, zeros, zeros), state(t)[
        1
    ]


def _claims_more(random: Random, t: int) -> Message:
    """A length, of names or numbers, that is not what follows."""
    payload, attachment = state(t)
    place = random.choice([12, 20, payload.index(b"elbow") + 8])
    length = random.choice([2**31 - 1, 2**32 - 1, 2**20, len(payload)])
    return payload[:place] + struct.pack("<I", length) + payload[place + 4 :], attachment


def _is_huge(random: Random, t: int) -> Message:
    return _of_many(random.choice([1000, 20_000])), state(t)[1]


@cache
def _of_many(n: int) -> bytes:
    values = np.zeros(n)
    return JointStateCodec([str(k) for k in range(n)]).encode(START, values, values, values)


KINDS = {
    "random": lambda random, t: (random.randbytes(random.randrange(400)), state(t)[1]),
    "random after a header": lambda random, t: (
        b"\x00\x01\x00\x00" + random.randbytes(random.randrange(400)),
        state(t)[1],
    ),
    "truncated": lambda random, t: (state(t)[0][: random.randrange(100)], state(t)[1]),
    "longer": lambda random, t: (
        state(t)[0] + random.randbytes(random.randrange(4, 99)),
        state(t)[1],
    ),
    "of other joints": _of_joints,
    "claims more": _claims_more,
    "huge": _is_huge,
    "without positions": lambda _, t: (
        CODEC.encode(START + t * PERIOD, NOTHING, NOTHING, np.zeros(2)),
        state(t)[1],
    ),
    "not finite position": lambda random, t: _values(random, (np.nan, np.inf, -np.inf), 0, t),
    "not finite torque": lambda random, t: _values(random, (np.nan, np.inf, -np.inf), 2, t),
    "nowhere": lambda random, t: _values(random, (1e4, -1e300, 1.8e308), 0, t),
    "no attachment": lambda _, t: (state(t)[0], b""),
    "attachment truncated": lambda random, t: (state(t)[0], state(t)[1][: random.randrange(18)]),
    "attachment of another version": lambda random, t: (
        state(t)[0],
        bytes([random.choice([0, 2, 255])]) + state(t)[1][1:],
    ),
    "attachment with unknown flags": lambda random, t: (
        state(t)[0],
        state(t)[1][:1] + bytes([random.randrange(4, 256)]) + state(t)[1][2:],
    ),
    "attachment of a model that is no text": lambda _, t: (state(t)[0], state(t)[1] + b"\xff\xfe"),
    "attachment of ROS": lambda random, t: (state(t)[0], b"\x02" + random.randbytes(32)),
}


def mutated(random: Random, t: int) -> Message:
    """Return a state with some bytes changed; it may be one that cannot be told from a true one."""
    message = [bytearray(part) for part in state(t)]
    for _ in range(random.randint(1, 4)):
        part = random.choice(message)
        part[random.randrange(len(part))] = random.randrange(256)
    return bytes(message[0]), bytes(message[1])
