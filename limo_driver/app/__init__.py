"""The roof: commands and functions, the one place that imports all packages."""
