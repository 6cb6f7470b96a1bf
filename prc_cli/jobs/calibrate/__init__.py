"""Calibration: what a stream says about its sensor, and the parameters that follow from it.

:mod:`.curves` counts support and background at all thresholds, :mod:`.sensor` measures noise and steps, :mod:`.implied`
turns both into parameters, :mod:`.search` tries parameters against a reference, :mod:`.calibrate` joins them.
"""
