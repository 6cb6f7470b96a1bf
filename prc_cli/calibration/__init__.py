"""Calibration: what a stream says about its sensor, and the parameters that follow from it."""
