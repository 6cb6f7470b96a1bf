"""Both papers in plain NumPy, SciPy and scikit-image, to be read beside them.

Without compiled loops.
"""
