"""The object dictionary of a simulated CANopen node: typed values that SDO and PDO reach."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

U8, U16, U32, I8, I16, I32 = "<B", "<H", "<I", "<b", "<h", "<i"
TEXT: Final = "text"

# SDO abort codes, CiA 301.
TOGGLE_NOT_ALTERNATED: Final = 0x05030000
UNKNOWN_COMMAND: Final = 0x05040001
WRITE_ONLY: Final = 0x06010001
READ_ONLY: Final = 0x06010002
NO_OBJECT: Final = 0x06020000
NOT_MAPPABLE: Final = 0x06040041
MAPPING_TOO_LONG: Final = 0x06040042
WRONG_LENGTH: Final = 0x06070010
NO_SUBINDEX: Final = 0x06090011
OUT_OF_RANGE: Final = 0x06090030
NOT_IN_THIS_STATE: Final = 0x08000022


class SdoAbort(Exception):  # noqa: N818  # CiA 301's word
    """An access that is answered with an abort code."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"SDO abort 0x{code:08X}")


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
