"""Compiled loops of PRC (Lehtola et al. 2019) and of its calibration."""
