"""Doctor: find out why a link to a controller does not work, and how to repair it."""
