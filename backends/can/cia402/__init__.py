"""CiA 402 drives over CANopen: their frames, start-up and states."""
