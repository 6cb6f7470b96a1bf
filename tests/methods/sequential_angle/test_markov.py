"""What starts the search for a car."""

import numpy as np

from prc_cli.methods.sequential_angle.car import suspicious
from prc_cli.methods.sequential_angle.thresholds import SuspiciousThresholds

CODES = {"M": 0, "T": 1, "H": 2, "V": 3, "U": 4}


def test_sky_fires():
    codes = np.array([[CODES[state] for state in "HHHVVVMMMM"]], np.uint8)
    assert suspicious(codes, np.array([10], np.int32), SuspiciousThresholds())[0] == 6
