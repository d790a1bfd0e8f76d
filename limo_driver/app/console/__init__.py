"""Parts shared by all commands: lookup, printing, and an orderly end at Ctrl-C."""
