"""A forest without end, made from a seed as it is walked through.

Terrain, trees, undergrowth, dead wood.
"""
