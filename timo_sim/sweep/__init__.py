"""Sweeps: many runs of one scene with varied parameters, on many cores or machines."""
