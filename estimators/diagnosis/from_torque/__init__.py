"""Arms whose torque is recorded: what the torque minus that of the simulation shows."""
