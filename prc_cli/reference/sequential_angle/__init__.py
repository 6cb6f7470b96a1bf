"""Stamos et al. (2012) in plain NumPy and SciPy."""
