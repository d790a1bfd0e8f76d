"""Recordings: measured motion and torque, their files, gaps and derivatives."""
