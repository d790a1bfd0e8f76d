"""The mapping that a log suggests: joints by name, units and time by what the data allow."""
