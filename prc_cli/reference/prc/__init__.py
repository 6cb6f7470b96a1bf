"""PRC (Lehtola et al. 2019) in plain NumPy, SciPy and scikit-image."""
