"""The object dictionary of a simulated drive, and the PDOs mapped to it.

PDOs of a simulated CANopen node: communication and mapping parameters, checked as in CiA 301.

A mapping is changed as the standard says: switch the PDO off (bit 31 of its COB-ID), set the number
of mapped objects to 0, write them, set their number, switch it on.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

U8, U16, U32, I8, I16, I32 = "<B", "<H", "<I", "<b", "<h", "<i"
TEXT: Final = "text"

# SDO abort codes, CiA 301.
TOGGLE_NOT_ALTERNATED: Final = 0x05030000
UNKNOWN_COMMAND: Final = 0x05040001
READ_ONLY: Final = 0x06010002
NO_OBJECT: Final = 0x06020000
NOT_MAPPABLE: Final = 0x06040041
MAPPING_TOO_LONG: Final = 0x06040042
WRONG_LENGTH: Final = 0x06070010
NO_SUBINDEX: Final = 0x06090011
OUT_OF_RANGE: Final = 0x06090030
NOT_IN_THIS_STATE: Final = 0x08000022
INVALID: Final = 1 << 31  # of a COB-ID: the PDO is switched off
NO_REMOTE: Final = 1 << 30
LARGEST_ID: Final = 0x7FF
MOST_OBJECTS: Final = 8
LONGEST: Final = 8  # [bytes]
LAST_SYNCHRONOUS: Final = 240  # transmission type
EVENT_DRIVEN: Final = (254, 255)
# A PDO on one of these would be taken for something else.
_RESERVED = (*range(0x081), *range(0x101, 0x181), *range(0x581, 0x5FF + 1), *range(0x601, 0x680))


class SdoAbort(Exception):  # noqa: N818  # CiA 301's word
    """An access that is answered with an abort code."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(code)

    def __str__(self) -> str:
        return f"SDO abort 0x{self.code:08X}"


@dataclass
class Variable:
    """One value of the dictionary.

    Args:
        kind: Its `struct` format, or `TEXT`.
        value: Its value now; a number, or a text.
        writable: Whether SDO may write it.
        mappable: Whether it may be part of a PDO.
        bounds: Least and largest value; those of its type where not given.
        check: Told a new value before it counts; raises `SdoAbort`.
        changed: Told a new value once it counts.
        read: Gives the value at every reading, where it is not stored.
    """

    kind: str
    value: int | str = 0
    writable: bool = False
    mappable: bool = False
    bounds: tuple[int, int] | None = None
    check: Callable[[int], None] | None = None
    changed: Callable[[int], None] | None = None
    read: Callable[[], int] | None = None
    size: int = field(init=False)  # [bytes]; 0 of a text

    def __post_init__(self) -> None:
        self.size = 0 if self.kind == TEXT else struct.calcsize(self.kind)

    def encode(self) -> bytes:
        """Return the value's bytes."""
        value = self.value if self.read is None else self.read()
        if isinstance(value, str):
            return value.encode("ascii")
        return struct.pack(self.kind, value)

    def decode(self, data: bytes) -> None:
        """Take a value from bytes of the right length.

        Raises:
            SdoAbort: Out of range, or not now.
        """
        (value,) = struct.unpack(self.kind, data)
        if self.bounds is not None and not self.bounds[0] <= value <= self.bounds[1]:
            raise SdoAbort(OUT_OF_RANGE)
        if self.check is not None:
            self.check(value)
        self.value = value
        if self.changed is not None:
            self.changed(value)


class ObjectDictionary:
    """Variables by index and subindex."""

    def __init__(self) -> None:
        self._variables: dict[tuple[int, int], Variable] = {}
        self._indices: set[int] = set()

    def add(self, index: int, subindex: int, variable: Variable) -> Variable:
        """Add a variable and return it."""
        self._variables[index, subindex] = variable
        self._indices.add(index)
        return variable

    def array(self, index: int, *variables: Variable) -> None:
        """Add variables from subindex 1 on, and their number as subindex 0."""
        self.add(index, 0, Variable(U8, len(variables)))
        for subindex, variable in enumerate(variables, start=1):
            self.add(index, subindex, variable)

    def find(self, index: int, subindex: int) -> Variable:
        """Return a variable.

        Raises:
            SdoAbort: There is none.
        """
        variable = self._variables.get((index, subindex))
        if variable is None:
            raise SdoAbort(NO_SUBINDEX if index in self._indices else NO_OBJECT)
        return variable

    def number(self, index: int, subindex: int = 0) -> int:
        """Return the number stored in a variable."""
        value = self.find(index, subindex).value
        if isinstance(value, str):
            raise TypeError(f"object {index:04X}:{subindex:02X} is a text")
        return value

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write a variable as SDO does.

        Raises:
            SdoAbort: Unknown, read-only, of another length, or out of range.
        """
        variable = self.find(index, subindex)
        if not variable.writable:
            raise SdoAbort(READ_ONLY)
        if len(data) != variable.size:
            raise SdoAbort(WRONG_LENGTH)
        variable.decode(data)


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
