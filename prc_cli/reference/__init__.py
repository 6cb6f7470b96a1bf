"""Both papers in plain NumPy, SciPy and scikit-image, to be read beside them; without compiled loops."""
