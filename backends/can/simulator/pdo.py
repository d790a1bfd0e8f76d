"""PDOs of a simulated CANopen node: communication and mapping parameters, checked as in CiA 301.

A mapping is changed as the standard says: switch the PDO off (bit 31 of its COB-ID), set the number
of mapped objects to 0, write them, set their number, switch it on.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final

from backends.can.simulator.objects import (
    MAPPING_TOO_LONG,
    NOT_IN_THIS_STATE,
    NOT_MAPPABLE,
    OUT_OF_RANGE,
    U8,
    U16,
    U32,
    ObjectDictionary,
    SdoAbort,
    Variable,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

INVALID: Final = 1 << 31  # of a COB-ID: the PDO is switched off
NO_REMOTE: Final = 1 << 30
LARGEST_ID: Final = 0x7FF
MOST_OBJECTS: Final = 8
LONGEST: Final = 8  # [bytes]
LAST_SYNCHRONOUS: Final = 240  # transmission type
EVENT_DRIVEN: Final = (254, 255)
# A PDO on one of these would be taken for something else.
_RESERVED = (*range(0x081), *range(0x101, 0x181), *range(0x581, 0x5FF + 1), *range(0x601, 0x680))


class SimulatedPdo:
    """One PDO and its four groups of entries in the dictionary.

    Args:
        objects: The dictionary of its node.
        communication: Index of its communication parameters, for example 0x1400.
        mapping: Index of its mapping, for example 0x1600.
        cob_id: Its arbitration id by default.
        mapped: Index and subindex of the objects in it by default.
        on: Whether it is switched on by default.
    """

    def __init__(
        self,
        objects: ObjectDictionary,
        communication: int,
        mapping: int,
        cob_id: int,
        mapped: Sequence[tuple[int, int]] = (),
        *,
        on: bool = True,
        transmission: int = 255,
    ) -> None:
        self._objects, self._mapping = objects, mapping
        self._receives = communication < 0x1800  # noqa: PLR2004  # where TPDOs begin
        self._defaults = (cob_id | (0 if on else INVALID), transmission, tuple(mapped))
        add = objects.add
        add(communication, 0, Variable(U8, 5))
        self._cob = add(
            communication, 1, Variable(U32, writable=True, check=self._check_id, changed=self._note)
        )
        self._type = add(
            communication,
            2,
            Variable(U8, writable=True, check=self._check_type, changed=self._note),
        )
        add(communication, 3, Variable(U16, writable=True))
        add(communication, 4, Variable(U8))
        self._timer = add(communication, 5, Variable(U16, writable=True, changed=self._note))
        self._count = add(
            mapping,
            0,
            Variable(U8, writable=True, bounds=(0, MOST_OBJECTS), check=self._check_count),
        )
        self._count.changed = self._note
        for k in range(1, MOST_OBJECTS + 1):
            add(mapping, k, Variable(U32, writable=True, check=self._check_entry))
        self.reset()

    def reset(self) -> None:
        """Go back to the defaults."""
        cob, transmission, mapped = self._defaults
        self._cob.value, self._type.value, self._timer.value = cob, transmission, 0
        for k in range(MOST_OBJECTS):
            entry = self._objects.find(self._mapping, k + 1)
            entry.value = self._entry_of(*mapped[k]) if k < len(mapped) else 0
        self._count.value = len(mapped)
        self.pending: bytes | None = None  # received, and not in force before the next SYNC
        self.syncs = 0  # since it was sent
        self._note(0)

    def pack(self) -> bytes:
        """Return the present content of a TPDO."""
        return b"".join([variable.encode() for variable in self._variables])

    def unpack(self, data: bytes) -> None:
        """Put what an RPDO carried into force; a value out of range is left alone.

        Raises:
            SdoAbort: It is shorter than its mapping.
        """
        if len(data) < self.length:
            raise SdoAbort(MAPPING_TOO_LONG)
        at = 0
        for variable in self._variables:
            with suppress(SdoAbort):
                variable.decode(data[at : at + variable.size])
            at += variable.size

    def _note(self, _value: int) -> None:
        """Keep what is looked at with every frame."""
        cob = int(self._cob.value)
        self.on = not cob & INVALID and bool(self._count.value)
        self.cob_id = cob & LARGEST_ID
        self.transmission = int(self._type.value)
        self.synchronous = self.transmission <= LAST_SYNCHRONOUS
        self.event_time = 1e-3 * int(self._timer.value)  # [s]; 0: none
        self._variables = [
            self._variable(int(self._objects.find(self._mapping, k + 1).value))
            for k in range(int(self._count.value))
        ]
        self.length = sum(variable.size for variable in self._variables)

    def _variable(self, entry: int) -> Variable:
        variable = self._objects.find(entry >> 16, entry >> 8 & 0xFF)
        if not variable.mappable or (self._receives and not variable.writable):
            raise SdoAbort(NOT_MAPPABLE)
        if entry & 0xFF != 8 * variable.size:
            raise SdoAbort(NOT_MAPPABLE)
        return variable

    def _entry_of(self, index: int, subindex: int) -> int:
        return index << 16 | subindex << 8 | 8 * self._objects.find(index, subindex).size

    def _check_id(self, cob: int) -> None:
        if cob & ~(INVALID | NO_REMOTE | LARGEST_ID):
            raise SdoAbort(OUT_OF_RANGE)
        if cob & INVALID:
            return
        before = int(self._cob.value)
        changes = (before ^ cob) & LARGEST_ID
        if cob & LARGEST_ID in _RESERVED or (changes and not before & INVALID):
            raise SdoAbort(OUT_OF_RANGE)  # an id changes only while the PDO is off

    def _check_type(self, transmission: int) -> None:
        if transmission > LAST_SYNCHRONOUS and transmission not in EVENT_DRIVEN:
            raise SdoAbort(OUT_OF_RANGE)

    def _check_entry(self, entry: int) -> None:
        if not int(self._cob.value) & INVALID or self._count.value:
            raise SdoAbort(NOT_IN_THIS_STATE)
        if entry:
            self._variable(entry)

    def _check_count(self, count: int) -> None:
        if not int(self._cob.value) & INVALID:
            raise SdoAbort(NOT_IN_THIS_STATE)
        entries = [int(self._objects.find(self._mapping, k + 1).value) for k in range(count)]
        if sum(self._variable(entry).size for entry in entries) > LONGEST:
            raise SdoAbort(MAPPING_TOO_LONG)
