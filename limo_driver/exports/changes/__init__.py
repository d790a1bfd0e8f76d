"""What has to change in the user's file, and what of it stays: compared with the simulation."""
