"""Calibration: estimates the sensor's properties from a stream, and derives parameters from them.

:mod:`.curves` counts support and background at all thresholds, :mod:`.sensor` measures noise and steps, :mod:`.implied`
turns both into parameters, :mod:`.search` tries parameters against a reference, :mod:`.calibrate` joins them.
"""
