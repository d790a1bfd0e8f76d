"""What programs of users import of `limo_driver.logs.readers`."""

from limo_driver.logs.readers import (
    Channels,
    Inspection,
    LogMapping,
    LogTable,
    Proposal,
    Taken,
    TimeColumns,
)

__all__ = ["Channels", "Inspection", "LogMapping", "LogTable", "Proposal", "Taken", "TimeColumns"]
