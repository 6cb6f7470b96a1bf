"""Parameters of the sequential tests, and what starts the search for a car."""

import numpy as np
import pytest

from prc_cli.core.config import build
from prc_cli.core.errors import ConfigError
from prc_cli.methods.keys import table_of
from prc_cli.methods.sequential_angle.car import suspicious
from prc_cli.methods.sequential_angle.thresholds import (
    MarkovThresholds,
    SuspiciousThresholds,
)


@pytest.mark.parametrize(
    "table, message",
    [
        (
            {"h0": [[0.9, 0.1, 0.1], [0.1, 0.9, 0.0], [0.0, 0.0, 1.0]]},
            "h0.*add up to 1, found a sum of 1.1",
        ),
        ({"h0": [[1.0, 0.0], [0.5, 0.5]]}, "h0"),
        ({"sigmas_deg": [30, 0, 30]}, "greater than 0"),
        ({"treshold": 1}, "did you mean 'threshold'"),
    ],
)
def test_wrong_parameters_are_told(table, message):
    with pytest.raises(ConfigError, match=message):
        build(table_of(MarkovThresholds(), "vegetation"), table, "street.toml")


CODES = {"M": 0, "T": 1, "H": 2, "V": 3, "U": 4}
PARAMS = SuspiciousThresholds()


def trigger(states: str, params: SuspiciousThresholds = PARAMS) -> int:
    codes = np.array([[CODES[state] for state in states]], np.uint8)
    return int(suspicious(codes, np.array([len(states)], np.int32), params)[0])


def test_sky_fires():
    assert trigger("HHHVVVMMMM") == 6
