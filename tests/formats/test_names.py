"""Usual names: of two directions beside a range the vertical one is the angle of the shot."""

from __future__ import annotations

import pytest

from prc_cli.formats.names import angle_rules, usual_names


@pytest.mark.parametrize(
    ("names", "angle", "down"),
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
def test_the_vertical_direction_is_the_angle(names: str, angle: str, down: str | None) -> None:
    words = names.split(";") if ";" in names else names.split()
    assert usual_names(words)["angle"].name == angle
    assert [rule.value for rule in angle_rules(angle)] == ([] if down is None else [down])


@pytest.mark.parametrize(
    ("name", "standard", "unit"),
    [
        ("Slant_Range", "range", ""),
        ("range/mm", "range", "mm"),
        ("Range [metres]", "range", ""),
        ("ScanAngleRank", "angle", ""),
        ("angle [°]", "angle", ""),
        ("angle in gon", "angle", "gon"),
        ("angle [radians]", "angle", "rad"),
        ("Line[-]", "scan_line", ""),
        ("Column (-)", "column", ""),
    ],
)
def test_names_and_units_of_usual_programs(name: str, standard: str, unit: str) -> None:
    usual = usual_names(["x", name])[standard]
    assert (usual.name, usual.unit) == (name, unit)


@pytest.mark.parametrize("names", ["range elevation", "x y elevation", "azimuth elevation"])
def test_an_elevation_alone_may_be_a_height(names: str) -> None:
    assert "angle" not in usual_names(names.split())
