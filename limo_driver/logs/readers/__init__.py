"""Recordings in formats that are not limo's own: any names, units, order; mapped, not guessed."""

from limo_driver.logs.readers.inspection import Inspection
from limo_driver.logs.readers.mapping import Channels, LogMapping, TimeColumns
from limo_driver.logs.readers.proposals.proposal import Proposal, Taken
from limo_driver.logs.readers.table import LogTable

__all__ = ["Channels", "Inspection", "LogMapping", "LogTable", "Proposal", "Taken", "TimeColumns"]
