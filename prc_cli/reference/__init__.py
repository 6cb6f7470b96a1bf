"""Both papers in plain NumPy, SciPy and scikit-image, to be read beside the paper; no compiled loop is used."""
