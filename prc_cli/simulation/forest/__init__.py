"""A forest without end, made from a seed as it is walked through: terrain, trees, undergrowth, dead wood."""
