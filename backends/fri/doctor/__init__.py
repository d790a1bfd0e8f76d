"""The doctor: what is wrong with a link to a controller, and what to do."""
