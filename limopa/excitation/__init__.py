"""Excitation: the motion that identifies rigid body and friction best."""
