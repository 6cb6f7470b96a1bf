from __future__ import annotations

import numpy as np
import pytest

from prc_cli.imaging.pictures import (
    AGREE_COLOUR,
    colour_map,
    difference_picture,
    range_bar,
    range_limits,
    range_picture,
    segment_picture,
    value_limits,
    value_picture,
)


def luminance(
    colours: np.ndarray[tuple[int, ...], np.dtype[np.uint8]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Relative luminance of sRGB colours (IEC 61966-2-1)."""
    share = colours / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear @ np.array([0.2126, 0.7152, 0.0722]))


def test_colours_rise_evenly_in_lightness() -> None:
    lightness = np.cbrt(luminance(colour_map()))
    steps = np.diff(lightness)
    assert (steps > 0).mean() > 0.97  # bytes are rounded
    assert lightness[::16].tolist() == sorted(lightness[::16].tolist())
    halves = np.ptp(lightness[:128]), np.ptp(lightness[128:])
    assert halves[0] == pytest.approx(halves[1], rel=0.25)


def test_near_is_brighter_than_far_and_missing_is_white() -> None:
    picture = range_picture(np.array([[1.0, 5.0, 25.0, np.nan]], dtype=np.float32))
    assert picture.shape == (1, 4, 3)
    assert picture.dtype == np.uint8
    light = luminance(picture[0])
    assert light[0] > light[1] > light[2]
    assert picture[0, 3].tolist() == [255, 255, 255]
    assert (picture[0, :3] != 255).any(axis=1).all()


def test_limits_hold_beyond_the_block() -> None:
    limits = (2.0, 50.0)
    near, far = range_picture(np.array([[1.0, 2.0]]), limits), range_picture(np.array([[50.0, 90.0]]), limits)
    assert near[0, 0].tolist() == near[0, 1].tolist() == colour_map()[255].tolist()
    assert far[0, 0].tolist() == far[0, 1].tolist() == colour_map()[0].tolist()


def test_segments_differ_are_stable_and_none_is_black() -> None:
    ids = np.arange(0, 500).reshape(1, -1)
    picture = segment_picture(ids)
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert len(np.unique(picture[0], axis=0)) > 490
    assert picture[0, 1:].max(axis=1).min() > 85
    assert np.array_equal(segment_picture(ids[:, 100:110])[0], picture[0, 100:110])
    assert segment_picture(np.array([[2**62]])).any()


def test_the_range_bar_shows_the_colours_of_the_picture() -> None:
    limits = (1.5, 60.0)
    bar = range_bar(limits)
    for place, text in bar.ticks:
        drawn = range_picture(np.array([[float(text)]]), limits)[0, 0].astype(int)
        shown = bar.colours[round(place * 255)].astype(int)
        assert np.abs(drawn - shown).max() <= 4
    assert [text for _, text in bar.ticks] == ["2", "5", "10", "20", "50"]


def test_limits_leave_out_what_lies_far_from_the_rest() -> None:
    values = np.concatenate([np.linspace(3.0, 5.0, 1000), [9000.0], [np.nan]])
    assert range_limits(values)[1] < 6.0
    assert value_limits(values)[1] < 6.0
    assert value_limits(np.array([np.nan])) == (0.0, 1.0)
    assert value_limits(np.array([4.0, 4.0])) == (4.0, 5.0)


def test_values_rise_in_lightness_and_nan_is_white() -> None:
    picture = value_picture(np.array([[0.0, 5.0, 10.0, np.nan]]), (0.0, 10.0))[0]
    light = luminance(picture)
    assert light[0] < light[1] < light[2]
    assert picture[3].tolist() == [255, 255, 255]


def test_differences_show_what_was_predicted_where_it_is_wrong() -> None:
    colours = np.array([[1, 1, 1], [10, 0, 0], [0, 20, 0]], np.uint8)
    predicted, reference = np.array([[1, 1, 0, 2]], np.uint8), np.array([[1, 2, 1, 0]], np.uint8)
    picture = difference_picture(predicted, reference, colours)
    assert picture[0].tolist() == [list(AGREE_COLOUR), [10, 0, 0], [255, 255, 255], [255, 255, 255]]
