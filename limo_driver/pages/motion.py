"""A planned motion on a page, under the name that programs import."""

from limo_driver.pages.arm_section import planned_motion

__all__ = ["planned_motion"]
