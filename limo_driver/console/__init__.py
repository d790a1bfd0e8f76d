"""What commands share: how they are found, print, and end at Ctrl-C."""
