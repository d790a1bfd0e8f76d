"""Read what files declare, YAML or JSON, so that every mistake is reported at its place.

A message says the file, the line (of YAML), the way to the entry, what was given, what was expected
and what exists.
"""

from limo_driver.runtime.declarations.given import Given
from limo_driver.runtime.declarations.json_file import JsonGiven, read_json
from limo_driver.runtime.declarations.yaml_file import YamlGiven, read_yaml

__all__ = ["Given", "JsonGiven", "YamlGiven", "read_json", "read_yaml"]
