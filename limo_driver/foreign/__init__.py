"""Recordings in formats that are not limo's own: any names, units, order; mapped, not guessed."""

from limo_driver.foreign.inspection import Inspection
from limo_driver.foreign.mapping import Channels, LogMapping, TimeColumns
from limo_driver.foreign.proposals.proposal import Proposal, Taken
from limo_driver.foreign.table import LogTable

__all__ = ["Channels", "Inspection", "LogMapping", "LogTable", "Proposal", "Taken", "TimeColumns"]
