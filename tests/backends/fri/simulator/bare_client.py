"""An FRI client that shares no code with limo: what a program of the vendor's SDK does.

Bytes are packed by hand, the socket blocks and is bound before anything is sent, and it behaves as
such programs are known to: it mirrors what it is told while it waits, answers every
receiveMultiplier-th packet, and exits with 0 at the end of a session and 1 on what it cannot read.
Run as a process; its last line is a JSON object of what it saw.

    python bare_client.py --port 30200 --generation 1 --mode position [--wrong jump]
"""

from __future__ import annotations

import argparse
import json
import math
import socket
import struct
import sys
import time
import zlib

IDLE, MONITORING_WAIT, MONITORING_READY, COMMANDING_WAIT, COMMANDING_ACTIVE = range(5)
MONITORING_ID, COMMAND_ID = 0x245142, 0x34001
PATIENCE = 100  # [s], so that a failing test ends


def varint(value: int) -> bytes:
    out = b""
    while value > 0x7F:
        out += bytes([value & 0x7F | 0x80])
        value >>= 7
    return out + bytes([value])


def fields(data: bytes) -> dict[int, list]:
    found: dict[int, list] = {}
    at = 0

    def number() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    while at < len(data):
        key = number()
        if key & 7 == 0:
            value = number()
        elif key & 7 == 1:
            value = struct.unpack_from("<d", data, at)[0]
            at += 8
        elif key & 7 == 2:
            size = number()
            value = data[at : at + size]
            at += size
        else:
            raise ValueError(f"wire type {key & 7}")
        found.setdefault(key >> 3, []).append(value)
    return found


def doubles(data: bytes) -> list[float]:
    values: list[float] = []
    for value in fields(data).get(1, []):  # unpacked or packed
        values += (
            [value] if isinstance(value, float) else struct.unpack(f"<{len(value) // 8}d", value)
        )
    return values


def joints(values: list[float]) -> bytes:
    inner = b"".join(b"\x09" + struct.pack("<d", value) for value in values)
    return varint(len(inner)) + inner


class Client:
    def __init__(self, generation: str, mode: str, wrong: str, amplitude: float) -> None:
        self.generation, self.mode, self.wrong, self.amplitude = generation, mode, wrong, amplitude
        self.sequence = self.received = self.answers = self.active = self.since = 0
        self.states: list[int] = []
        self.seen: dict[str, object] = {}
        self.first_reflected: int | None = None
        self.enough: int | None = None  # packets after which the test may end

    def run(self, sock: socket.socket) -> int:
        gives_up = time.monotonic() + PATIENCE
        while True:
            packet, robot = sock.recvfrom(1500)
            if time.monotonic() > gives_up:
                self.seen["failed"] = f"the session was not over after {PATIENCE} s"
                return 1
            self.received += 1
            try:
                state, answer = self.step(packet)
            except (ValueError, KeyError, IndexError, struct.error) as error:
                self.seen["failed"] = repr(error)
                return 1
            if not self.states or self.states[-1] != state:
                self.states.append(state)
            if state == IDLE:
                return 0
            self.tell_when_enough()
            if answer is not None:
                sock.sendto(answer, robot)
                self.answers += 1
                if self.wrong == "leave" and self.active > 50:
                    print(json.dumps({"enough": True}), flush=True)  # noqa: T201
                    return 0

    def tell_when_enough(self) -> None:
        """Say on stdout when the session has shown what there is to see."""
        never_active = self.wrong in {"garbage", "stale"}
        seen = self.received > 50 if never_active else self.active > (50 if self.wrong else 60)
        if seen and self.enough is None and self.wrong != "leave":
            self.enough = self.received + (100 if self.wrong else 0)
        if self.enough == self.received:
            print(json.dumps({"enough": True}), flush=True)  # noqa: T201

    def step(self, packet: bytes) -> tuple[int, bytes | None]:
        if self.generation == "2.7":
            size, crc = (
                struct.unpack_from("<I", packet)[0],
                struct.unpack_from("<I", packet[-4:])[0],
            )
            if size != len(packet) - 8 or crc != zlib.crc32(packet[4:-4]):
                raise ValueError("frame")
            packet = packet[4:-4]
        message = fields(packet)
        header = fields(message[1][0])
        if header[1][0] != MONITORING_ID:
            raise ValueError("identifier")
        connection = fields(message[4][0])
        state, quality = connection[1][0], connection[2][0]
        self.seen["period"], multiplier = connection[3][0], connection.get(4, [1])[0] or 1
        data, ipo = fields(message[3][0]), fields(message[5][0])
        self.seen["quality"] = max(quality, self.seen.get("quality", 0))
        robot = fields(message[2][0])
        self.seen["safety"] = max(robot[2][0], self.seen.get("safety", 0))
        self.seen.setdefault("control", []).append(robot[7][0])
        self.seen["control"] = sorted(set(self.seen["control"]))
        measured, external = doubles(data[1][0]), doubles(data[5][0])
        if len(measured) != 7:
            raise ValueError("joints")
        self.seen["measured"], self.seen["external"] = measured, external
        tracking = ipo[12][0]
        if state != COMMANDING_ACTIVE and tracking != 0.0:
            raise ValueError("tracking performance")
        if state == COMMANDING_ACTIVE:
            self.seen["tracking"] = max(tracking, self.seen.get("tracking", 0.0))
            self.active += 1
        if state == IDLE:
            return state, None
        self.since += 1
        if self.since < multiplier:
            return state, None
        self.since = 0
        return state, self.answer(state, header[2][0], data, ipo)

    def answer(self, state: int, reflected: int, data: dict, ipo: dict) -> bytes | None:
        body = b""
        if state >= COMMANDING_WAIT:
            body = self.commands(state, doubles(ipo[1][0]))  # fails without an ipo position
        elif self.generation == "1":
            body = b"\x0a" + joints(doubles(data[3][0]))
        if self.wrong == "stale":
            if self.first_reflected is None:
                self.first_reflected = reflected
            reflected = self.first_reflected
        head = b"\x08" + varint(COMMAND_ID) + b"\x10" + varint(self.sequence)
        head += b"\x18" + varint(reflected)
        self.sequence += 1
        out = b"\x0a" + varint(len(head)) + head
        if body:
            out += b"\x12" + varint(len(body)) + body
        if self.generation == "2.7":
            out = struct.pack("<I", len(out)) + out + struct.pack("<I", zlib.crc32(out))
        return b"\xff\x00no command" if self.wrong == "garbage" else out

    def commands(self, state: int, base: list[float]) -> bytes:
        torque, wrench = [0.0] * 7, [0.0] * 6
        if state == COMMANDING_ACTIVE:
            swing = self.amplitude * math.sin(2 * math.pi * self.active / 400)
            if self.mode == "position":
                base = [*base[:6], base[6] + swing]
            torque[6], wrench[2] = swing, 20.0 * self.amplitude
        if self.wrong == "jump" and self.active > 50:
            base[0] += 0.5
        body = b"\x0a" + joints(base)
        if self.mode == "wrench":
            body += b"\x12\x32\x0a\x30" + struct.pack("<6d", *wrench)
        if self.mode == "torque":
            body += b"\x1a" + joints(torque)
        return body


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--port", type=int, default=30200)
    parser.add_argument("--generation", choices=["1", "2.5", "2.7"], default="1")
    parser.add_argument("--mode", choices=["position", "torque", "wrench"], default="position")
    parser.add_argument("--wrong", default="")
    parser.add_argument("--amplitude", type=float, default=0.05)
    given = parser.parse_args()
    client = Client(given.generation, given.mode, given.wrong, given.amplitude)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("0.0.0.0", given.port))  # noqa: S104
        print(json.dumps({"bound": sock.getsockname()[1]}), flush=True)  # noqa: T201
        sock.settimeout(PATIENCE)  # only so that a failing test ends
        status = client.run(sock)
    counted = {"states": client.states, "received": client.received, "answers": client.answers}
    print(json.dumps(counted | {"active": client.active} | client.seen), flush=True)  # noqa: T201
    return status


if __name__ == "__main__":
    sys.exit(main())
