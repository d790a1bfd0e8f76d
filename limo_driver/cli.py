"""Where the script `limo` begins; the commands stand in `limo_driver.app.cli`."""

from limo_driver.app.cli import main

__all__ = ["main"]
