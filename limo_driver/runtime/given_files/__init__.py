"""The door for files that a user gives, or a stranger: what is none, or costs much, is refused.

Each reader has the same budget of bytes, rows and seconds (`ReadingBudget`), and refuses in one
line that says what was given and what is allowed. What reads in Python counts what it has spent
(`Spent`); what reads in a library that nobody can interrupt does so in a process of its own
(`apart`).
"""

from limo_driver.runtime.given_files.budget import ReadingBudget, Spent
from limo_driver.runtime.given_files.contents import (
    json_of,
    read_bytes,
    read_json_file,
    read_text,
    text_of,
)
from limo_driver.runtime.given_files.door import check_file
from limo_driver.runtime.given_files.separate import apart

__all__ = [
    "ReadingBudget",
    "Spent",
    "apart",
    "check_file",
    "json_of",
    "read_bytes",
    "read_json_file",
    "read_text",
    "text_of",
]
