"""Identify and configure a CiA 402 drive before it is switched on.

It has to be the drive that the joint has, and it has to stop by itself when this program falls
silent: a drive that cannot be told so is refused.

Source: CiA 301, sections 7.5.2.14 (heartbeat consumer) and 7.5.2.35 to 38 (PDO); CiA 402-2,
sections 8.4 (option codes) and 11.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from backends.can.cia402.codec import OperatingMode, State, describe
from backends.can.cia402.drive import Drive, longest_lag
from backends.can.config import ArmConfig, Cia402Joint, DriveError, SdoAbortError
from backends.can.port import RPDO1, RPDO2, SYNC, TPDO1, TPDO2, TPDO3

if TYPE_CHECKING:
    from backends.can.cia402.sdo import SdoClient

DRIVE_PROFILE: Final = 402  # low word of object 1000
INVALID: Final = 1 << 31  # of a PDO's id: not in use
EVERY_SYNC: Final = 1  # transmission type; n is every n-th
RATED_TOLERANCE: Final = 0.01  # relative, between arm.yaml and object 6076
ON_LOST: Final = {"fault": 1, "disable": 2, "quick_stop": 3}  # object 6007
# After a quick stop the drive keeps the pose: an arm without brakes would fall.
QUICK_STOP_AND_STAY: Final = 6  # object 605A
FAULT_RAMP: Final = 2  # object 605E: stop on the quick-stop ramp, then switch off
IDENTITY: Final = {"vendor": 1, "product": 2, "revision": 3, "serial": 4}  # object 1018
LARGEST_BYTE: Final = 0xFF
SWITCHED_OFF: Final = 0xFFFF_FFFF  # object 6065: no following error
SPARE: Final = (0x1402, 0x1403, 0x1802, 0x1803)  # PDOs that drives may have switched on


@dataclass(frozen=True)
class PdoSpecification:
    """A PDO: its id without the node, where it is configured, and what is in it."""

    id: int
    communication: int  # object
    mapping: int  # object
    content: tuple[tuple[int, int, int], ...]  # object, subindex, bits
    transmission: int = EVERY_SYNC
    event_timer: int = 0  # [ms]


@dataclass(frozen=True)
class Commissioning:
    """Configures the drive of one joint.

    Args:
        config: The arm.
        joint: What is to be known of the joint.
        drive: Its drive.
        sdo: The way to its objects.
    """

    config: ArmConfig
    joint: Cia402Joint
    drive: Drive
    sdo: SdoClient

    def identify(self) -> int:
        """Check that this is the drive of the joint; return object 6076, its rating [mN m].

        Raises:
            DriveError: It is another.
        """
        profile = self.sdo.read(0x1000) & 0xFFFF
        if profile != DRIVE_PROFILE:
            self._fail(f"is no CiA 402 drive: object 1000 says profile {profile}")
        if self.joint.vendor is not None and self.sdo.read(0x1018, 1) != self.joint.vendor:
            self._fail(f"is not of vendor {self.joint.vendor:#x}: {self.sdo.read(0x1018, 1):#x}")
        if self.joint.serial is not None:
            self._check_serial(self.joint.serial, self.sdo.read(0x1018, 4))
        rated = self.sdo.read(0x6076)
        expected = 1e3 * self.joint.rated_torque / self.joint.torque_ratio
        if abs(rated - expected) > RATED_TOLERANCE * expected:
            self._fail(
                f"is rated {rated} mN m (object 6076), expected {expected:.0f} mN m for "
                f"rated_torque {self.joint.rated_torque:g} N m; another drive, or swapped cables?"
            )
        return rated

    def versions(self) -> dict[str, int]:
        """Return vendor, product, revision and serial number, as far as the drive has them."""
        found = dict[str, int]()
        for name, subindex in IDENTITY.items():
            try:
                found[name] = self.sdo.read(0x1018, subindex)
            except SdoAbortError as error:
                if not error.is_absent:
                    raise
        return found

    def configure(self) -> None:
        """Set PDOs, SYNC, watchdogs, reactions and mode; the drive is not switched on.

        Raises:
            DriveError: It cannot be configured as it has to be.
        """
        period_us = round(1e6 / self.config.rate)
        pdos = self._pdos()
        for pdo in pdos:
            self._map(pdo)
        for index in SPARE:
            if index not in {pdo.communication for pdo in pdos}:
                self._switch_off(index)
        self._set_if_there(0x1005, 0, SYNC, 4)
        self._set_if_there(0x1006, 0, period_us, 4)
        self._set_interpolation(period_us)
        self._set_watchdogs()
        self._set_following()
        self.sdo.write(0x6060, 0, OperatingMode.POSITION, 1, signed=True)
        self.drive.mode = None  # until it says so

    def start_values(self, *, reset: bool) -> None:
        """Read where it stands, as the first of its positions.

        Raises:
            DriveError: It is in fault, which is reset only if that is asked for.
        """
        self.drive.count = self.sdo.read(0x6064, signed=True)
        self.drive.take_statusword(self.sdo.read(0x6041))
        self.drive.error = self.sdo.read(0x603F)
        if self.drive.state in {State.FAULT, State.FAULT_REACTION} and not reset:
            text = describe(self.drive.error) or "it gives no error code"
            self._fail(
                f"is in fault: {text}; once that is cured, "
                "open with reset_faults=True (limo run --reset-faults)"
            )

    def is_watched(self) -> bool:
        """Say whether it still has its watchdogs, which it forgets when it restarts.

        Raises:
            DriveError: No answer.
        """
        return (
            self.sdo.read(0x1400, 5) == self._watchdog
            and self.sdo.read(0x1016, 1) == self._watched_node
        )

    def forget_master(self) -> None:
        """Let the drive not miss this program's heartbeat."""
        self.sdo.write(0x1016, 1, 0, 4)

    def _pdos(self) -> list[PdoSpecification]:
        slowly = self.config.status_every
        pdos = [
            PdoSpecification(
                RPDO1,
                0x1400,
                0x1600,
                ((0x6040, 0, 16), (0x607A, 0, 32), (0x60B2, 0, 16)),
                event_timer=self._watchdog,
            ),
            PdoSpecification(RPDO2, 0x1401, 0x1601, ((0x6071, 0, 16), (0x6060, 0, 8))),
            PdoSpecification(
                TPDO1, 0x1800, 0x1A00, ((0x6041, 0, 16), (0x6064, 0, 32), (0x6077, 0, 16))
            ),
            PdoSpecification(
                TPDO2, 0x1801, 0x1A01, ((0x606C, 0, 32), (0x603F, 0, 16), (0x6061, 0, 8)), slowly
            ),
        ]
        if (heat := self.config.temperature) is not None:
            pdos.append(
                PdoSpecification(TPDO3, 0x1802, 0x1A02, ((heat.object, heat.subindex, 16),), slowly)
            )
        return pdos

    def _map(self, pdo: PdoSpecification) -> None:
        """Configure a PDO in the order that CiA 301 asks for."""
        write, known_as = self.sdo.write, pdo.id + self.drive.node
        write(pdo.communication, 1, INVALID | known_as, 4)
        write(pdo.mapping, 0, 0, 1)
        for place, (index, subindex, bits) in enumerate(pdo.content, start=1):
            write(pdo.mapping, place, index << 16 | subindex << 8 | bits, 4)
        write(pdo.mapping, 0, len(pdo.content), 1)
        write(pdo.communication, 2, pdo.transmission, 1)
        if pdo.event_timer:
            self._require(pdo.communication, 5, pdo.event_timer, 2)
        write(pdo.communication, 1, known_as, 4)

    @property
    def _watchdog(self) -> int:
        return round(1e3 * self.config.watchdog)  # [ms]

    @property
    def _watched_node(self) -> int:
        return self.config.master << 16 | self._watchdog  # as in object 1016

    def _switch_off(self, index: int) -> None:
        """Switch off a PDO that is not used, where the drive has it; its id stays."""
        try:
            known_as = self.sdo.read(index, 1)
        except SdoAbortError as error:
            if not error.is_absent:
                raise
            return
        if not known_as & INVALID:
            self.sdo.write(index, 1, INVALID | known_as, 4)

    def _set_watchdogs(self) -> None:
        self._require(0x6007, 0, ON_LOST[self.config.on_lost], 2)
        self._set_if_there(0x605A, 0, QUICK_STOP_AND_STAY, 2)
        self._set_if_there(0x605E, 0, FAULT_RAMP, 2)
        self._require(0x1016, 1, self._watched_node, 4)
        self.sdo.write(0x1017, 0, max(self._watchdog // 4, 1), 2)

    def _set_following(self) -> None:
        """Let a drive that can do so notice, too, that it does not follow.

        It compares with the set-point of now, behind which a joint that moves is.
        """
        late = longest_lag(1.0 / self.config.rate)
        fastest = float(self.config.model.limits.velocity[self.drive.joint - 1])
        window = self.config.following_error + fastest * late
        counts = min(round(window * abs(self.joint.counts_per_radian)), SWITCHED_OFF - 1)
        self._set_if_there(0x6065, 0, counts, 4)
        self._set_if_there(0x6066, 0, math.ceil(1e3 * late), 2)

    def _set_interpolation(self, period_us: int) -> None:
        """Tell the time between set-points, value times ten to the exponent [s]."""
        value, exponent = period_us, -6
        while value > LARGEST_BYTE or value % 10 == 0:
            value, exponent = round(value / 10), exponent + 1
        self._set_if_there(0x60C2, 1, value, 1)
        self._set_if_there(0x60C2, 2, exponent, 1, signed=True)

    def _require(self, index: int, subindex: int, value: int, size: int) -> None:
        """Set what makes the drive stop by itself."""
        try:
            self.sdo.write(index, subindex, value, size)
        except SdoAbortError as error:
            self._fail(
                f"would go on moving when set-points stop coming: object {index:04X}:"
                f"{subindex:02X} cannot be set to {value} ({error.code:08X}); not used"
            )

    def _set_if_there(
        self, index: int, subindex: int, value: int, size: int, *, signed: bool = False
    ) -> None:
        try:
            self.sdo.write(index, subindex, value, size, signed=signed)
        except SdoAbortError as error:
            if not error.is_absent:
                raise

    def _check_serial(self, expected: int, serial: int) -> None:
        if serial == expected:
            return
        owner = next(
            (
                j
                for j, joint in enumerate(self.config.joints, start=1)
                if getattr(joint, "serial", None) == serial
            ),
            None,
        )
        whose = "" if owner is None else f", which is the drive of joint {owner}: swapped?"
        self._fail(f"has serial number {serial}, expected {expected}{whose}")

    def _fail(self, message: str) -> None:
        raise DriveError(self.drive.joint, self.drive.node, message)
