"""State machine of a CiA 402 drive: the transitions that each controlword causes.

Source: IEC 61800-7-201 (CiA 402), "Finite state automaton".
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class StatuswordState(IntEnum):
    """States; each value is the statusword's bits that say so."""

    SWITCH_ON_DISABLED = 0x40
    READY = 0x21
    SWITCHED_ON = 0x23
    ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


POWERED: Final = {
    StatuswordState.ENABLED,
    StatuswordState.QUICK_STOP,
    StatuswordState.FAULT_REACTION,
}
FAULTY: Final = {StatuswordState.FAULT_REACTION, StatuswordState.FAULT}
FAULT_RESET: Final = 0x80

# Bits of the controlword: switch on, enable voltage, quick stop (active low), enable operation.
_DISABLE_VOLTAGE = (0x02, 0x00)  # mask and value of each command
_QUICK_STOP = (0x06, 0x02)
_SHUTDOWN = (0x07, 0x06)
_SWITCH_ON = (0x0F, 0x07)
_ENABLE = (0x0F, 0x0F)

_S = StatuswordState
_OFF = {
    _S.READY: _S.SWITCH_ON_DISABLED,
    _S.SWITCHED_ON: _S.SWITCH_ON_DISABLED,
}
_TRANSITIONS: Final[dict[tuple[int, int], dict[StatuswordState, StatuswordState]]] = {
    _DISABLE_VOLTAGE: {
        **_OFF,
        _S.ENABLED: _S.SWITCH_ON_DISABLED,
        _S.QUICK_STOP: _S.SWITCH_ON_DISABLED,
    },
    _QUICK_STOP: {**_OFF, _S.ENABLED: _S.QUICK_STOP},
    _SHUTDOWN: {
        _S.SWITCH_ON_DISABLED: _S.READY,
        _S.SWITCHED_ON: _S.READY,
        _S.ENABLED: _S.READY,
    },
    _SWITCH_ON: {_S.READY: _S.SWITCHED_ON, _S.ENABLED: _S.SWITCHED_ON},
    # Enabling from `ready` passes `switched on`, as the standard allows.
    _ENABLE: {_S.READY: _S.ENABLED, _S.SWITCHED_ON: _S.ENABLED},
}


def commanded(state: StatuswordState, controlword: int, before: int) -> StatuswordState:
    """Return the state that a controlword leads to.

    Args:
        state: The state it meets.
        controlword: Object 6040 as written now.
        before: The controlword before it: a fault is reset by the rise of bit 7 alone.
    """
    if state is StatuswordState.FAULT:
        rises = controlword & FAULT_RESET and not before & FAULT_RESET
        return StatuswordState.SWITCH_ON_DISABLED if rises else state
    if controlword & FAULT_RESET:
        return state  # the other bits mean nothing then
    for (mask, value), moves in _TRANSITIONS.items():
        if controlword & mask == value:
            return moves.get(state, state)
    return state


def enables(controlword: int) -> bool:
    """Say whether a controlword enables operation."""
    mask, value = _ENABLE
    return controlword & (mask | FAULT_RESET) == value
