"""What programs of users import of `limo_driver.runtime.outputs`."""

from limo_driver.runtime.outputs import require_folder

__all__ = ["require_folder"]
