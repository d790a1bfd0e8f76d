"""Settings: every number of the diagnosis that somebody chose, by stage, in one place."""
