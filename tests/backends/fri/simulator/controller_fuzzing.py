"""Datagrams of every kind at the simulated controller, in answer to its packets."""

import json
import random
import select
import signal
import socket

from controller_runs import LIMO, PATIENCE, process

from backends.fri.codec.codec import decode_monitoring, encode_command
from backends.fri.codec.messages import Command, CommandData, FriVersion, Header

VERSION = FriVersion.V1_15
BURST = 32  # mutants for each good answer


def mutants(datagram, chance, count=BURST):
    """Return datagrams that a good one can become: bits, ends, pieces, noise."""
    for _ in range(count):
        data = bytearray(datagram)
        at, kind = chance.randrange(len(data)), chance.randrange(6)
        if kind == 0:
            for _ in range(chance.randrange(1, 9)):
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        elif kind == 1:
            del data[at:]
        elif kind == 2:
            data[at:at] = chance.randbytes(chance.randrange(1, 20))
        elif kind == 3:
            del data[at : at + chance.randrange(1, 20)]
        elif kind == 4:
            data = bytearray(chance.randbytes(chance.randrange(1501)))
        else:
            data[at] = 0xFF
        yield bytes(data)


def answer_to(packet, sequence):
    """Return a good answer."""
    position = packet.ipo.joint_position or packet.data.commanded_position
    header = Header(sequence, packet.header.sequence)
    return encode_command(Command(header, CommandData(joint_position=position)), VERSION)


def newest(client):
    """Return the newest packet; bursts for all that piled up are more than the kernel keeps."""
    datagram = client.recvfrom(1500)
    while select.select([client], [], [], 0)[0]:
        datagram = client.recvfrom(1500)
    return datagram


def fuzz_controller(count, seed=0):
    """Answer a controller's packets properly, each answer after a burst of mutants of it.

    Returns:
        The datagrams sent, the controller's report, and its last packet.
    """
    chance = random.Random(seed)  # noqa: S311  # no secret
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.bind(("127.0.0.1", 0))
    client.settimeout(PATIENCE)
    address = f"127.0.0.1:{client.getsockname()[1]}"
    with client, process(*LIMO, "controller", "--client", address, "--json") as robot:
        sent = sequence = 0
        while True:
            data, sender = newest(client)
            packet = decode_monitoring(data, VERSION)
            if packet.connection.session_state == 0:
                break
            good = answer_to(packet, sequence)
            sequence += 1
            for datagram in (*mutants(good, chance), good) if sent < count else (good,):
                client.sendto(datagram, sender)
                sent += 1
            if sent >= count and count:
                robot.send_signal(signal.SIGINT)
                count = 0
        said, complained = robot.communicate(timeout=PATIENCE)
    assert robot.returncode == 0, complained
    return sent, json.loads(said.splitlines()[-1]), packet
