"""Table I of Çallar and Böttger 2022, on any data of the same kind."""
