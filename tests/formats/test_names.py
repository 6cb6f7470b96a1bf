"""Usual names: of two directions beside a range the vertical one is the angle of the shot."""

import pytest

from prc_cli.formats.names import angle_rules, usual_names


@pytest.mark.parametrize(
    "names, angle, down",
    [
        ("range azimuth elevation", "elevation", "-90"),
        ("range elevation azimuth", "elevation", "-90"),
        ("Range;Azimuth [deg];Elevation angle [deg]", "Elevation angle [deg]", "-90"),
        ("distance hz v", "v", None),
        ("range azimuth zenith", "zenith", "180"),
        ("range azimuth", "azimuth", None),
        ("range scan_angle azimuth elevation", "scan_angle", None),
        ("range theta phi", "theta", None),
    ],
)
def test_the_vertical_direction_is_the_angle(names, angle, down):
    words = names.split(";") if ";" in names else names.split()
    assert usual_names(words)["angle"].name == angle
    assert [rule.value for rule in angle_rules(angle)] == ([] if down is None else [down])
