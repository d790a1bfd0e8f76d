"""Diagnosis: where a simulation and recordings differ, and what physics was left out."""
