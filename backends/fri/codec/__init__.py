"""FRI's datagrams as values: every version, strict, and fast on the hot path."""
