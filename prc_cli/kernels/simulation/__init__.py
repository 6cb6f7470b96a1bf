"""Compiled loops of the simulator: rays, surfaces, sensor."""
