"""The gate that every recording passes: which of its rows can be used."""
