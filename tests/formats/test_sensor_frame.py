"""The frame of a spinning scanner, from its rings."""

from prc_cli.core.frame import SensorFrame


def test_frames_are_shown():
    assert SensorFrame(apex_m=(1.0, 0.0, 0.5)).shown() == "the scanner is at 1.00, 0.00, 0.50"
