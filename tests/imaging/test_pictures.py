from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from prc_cli.core.classes import LABEL_COLOURS, Label
from prc_cli.core.errors import InputError, OutputError
from prc_cli.imaging.pictures import (
    MAX_WIDTH,
    colour_map,
    label_picture,
    mask_picture,
    range_picture,
    segment_picture,
    stack_pictures,
    write_png,
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


@pytest.mark.parametrize("range_m", [np.full((2, 3), np.nan), np.full((2, 3), 7.0), np.empty((0, 3))])
def test_ranges_without_spread(range_m: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    assert range_picture(range_m).shape == (*range_m.shape, 3)


@pytest.mark.parametrize("limits", [(0.0, 5.0), (5.0, 5.0), (9.0, 2.0)])
def test_limits_that_make_no_sense(limits: tuple[float, float]) -> None:
    with pytest.raises(InputError, match=r"limits_m: found .*, expected 0 < near < far"):
        range_picture(np.ones((2, 2)), limits)


def test_labels_have_the_colours_of_the_table() -> None:
    labels = np.array([list(Label)], dtype=np.uint8)
    assert [tuple(colour) for colour in label_picture(labels)[0].tolist()] == list(LABEL_COLOURS.values())


def test_class_codes_are_no_labels() -> None:
    with pytest.raises(InputError, match="labels: found numbers from 2 to 64, expected labels from 0 to 10"):
        label_picture(np.array([[2, 64]], dtype=np.uint8))


def test_segments_differ_are_stable_and_none_is_black() -> None:
    ids = np.arange(0, 500).reshape(1, -1)
    picture = segment_picture(ids)
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert len(np.unique(picture[0], axis=0)) > 490
    assert picture[0, 1:].max(axis=1).min() > 85
    assert np.array_equal(segment_picture(ids[:, 100:110])[0], picture[0, 100:110])
    assert segment_picture(np.array([[2**62]])).any()


def test_neighbouring_segments_are_told_apart() -> None:
    picture = segment_picture(np.arange(1, 200).reshape(1, -1))[0].astype(int)
    assert np.abs(np.diff(picture, axis=0)).sum(axis=1).min() > 60


def test_mask_is_black_and_white() -> None:
    assert mask_picture(np.array([[True, False]])).tolist() == [[[255] * 3, [0] * 3]]


def plain(lines: int, columns: int, colour: int = 90) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return np.full((lines, columns, 3), colour, dtype=np.uint8)


@pytest.mark.parametrize(
    ("lines", "columns"), [(99, 2154), (255, 4270), (600, 2154), (389, 229), (20_000, 229), (1, 16), (3, 100_000)]
)
def test_stacks_are_wide_enough_to_see_and_narrow_enough_to_show(lines: int, columns: int) -> None:
    stack = stack_pictures([("range", plain(lines, columns))])
    assert 900 <= stack.width <= MAX_WIDTH + 24
    assert 100 <= stack.height <= 2600


def test_stack_shows_pictures_from_top_to_bottom_and_the_legend() -> None:
    pictures = [("first", plain(99, 1200, 50)), ("second", plain(99, 1200, 200))]
    stack = stack_pictures(pictures)
    with_legend = stack_pictures(pictures, legend=[Label.GROUND, Label.CAR])
    assert with_legend.height > stack.height
    column = [stack.getpixel((600, y)) for y in range(stack.height)]
    assert column.index((50, 50, 50)) < column.index((200, 200, 200))
    bottom = np.asarray(with_legend)[stack.height - 12 :]
    for label in (Label.GROUND, Label.CAR):
        assert (bottom == LABEL_COLOURS[label]).all(axis=2).any()


def test_long_scans_are_turned_so_that_time_runs_to_the_right() -> None:
    picture = plain(2000, 200, 0)
    picture[1000:] = 255
    pixels = np.asarray(stack_pictures([("scan", picture)]))
    middle = pixels[pixels.shape[0] // 2, :, 0]
    assert (middle[30:900] == 0).all()
    assert (middle[1100:1900] == 255).all()


def test_colours_are_never_mixed() -> None:
    labels = np.random.default_rng(1).integers(0, 2, (50, 5000)) * 255
    pixels = np.asarray(stack_pictures([("", np.repeat(labels[..., None], 3, axis=2).astype(np.uint8))]))
    assert set(np.unique(pixels[60:-20, 20:-20])) == {0, 255}


@pytest.mark.parametrize(
    ("pictures", "expected"),
    [
        ([], "pictures: found none, expected at least one"),
        ([("grey", np.zeros((3, 4), np.uint8))], r"grey: found uint8 of shape \(3, 4\), expected uint8"),
        ([("wide", np.zeros((3, 4, 3)))], "wide: found float64"),
        ([("none", np.zeros((0, 4, 3), np.uint8))], "none: found uint8 of shape"),
    ],
)
def test_pictures_that_cannot_be_stacked(
    pictures: list[tuple[str, np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]], expected: str
) -> None:  # fmt: skip
    with pytest.raises(InputError, match=expected):
        stack_pictures(pictures)


def test_png_holds_the_pixels_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    picture = segment_picture(np.arange(12).reshape(3, 4))
    write_png(tmp_path / "segments.png", picture)
    with Image.open(tmp_path / "segments.png") as image:
        assert np.array_equal(np.asarray(image), picture)
        assert image.format == "PNG"
    assert [path.name for path in tmp_path.iterdir()] == ["segments.png"]


def test_same_pixels_same_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        write_png(tmp_path / name, stack_pictures([("t", plain(99, 1200))], legend=[Label.GROUND]))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_png_into_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"a\.png: cannot be written"):
        write_png(tmp_path / "none" / "a.png", plain(2, 2))
