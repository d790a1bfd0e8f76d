"""The effects of the catalogue, one family a file: bodies, friction, hysteresis, gears, sensors."""
