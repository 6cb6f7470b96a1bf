"""Compiled loops of the simulator: rays, surfaces, what the sensor makes of them."""
