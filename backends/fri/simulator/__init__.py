"""A simulated FRI controller: an iiwa in MuJoCo that real FRI clients cannot tell from a robot."""
