"""Simulations written back into the files of other simulators: only what differs changes."""

from limo_driver.exports.export import Export
from limo_driver.exports.remainder import Remainder

__all__ = ["Export", "Remainder"]
