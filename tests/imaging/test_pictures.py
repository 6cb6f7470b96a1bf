"""Pixels, colours, scales and sheets."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image

from prc_cli.core.errors import InputError
from prc_cli.core.types import U8
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
from prc_cli.imaging.sheet import (
    LEFT,
    TITLE_HEIGHT,
    Axis,
    Panel,
    draw_panel,
    draw_sheet,
    zoom_for,
)
from prc_cli.imaging.viewer import html_page


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


def plain(height: int, width: int, colour: int = 90) -> U8:
    return np.full((height, width, 3), colour, dtype=np.uint8)


def panel(picture: U8, title: str = "range", **options: object) -> Panel:
    x, y = Axis("column", 0, picture.shape[1]), Axis("line", 0, picture.shape[0])
    return Panel(title, picture, x, y, **options)  # type: ignore[arg-type]


def test_pixels_stand_where_they_belong_and_are_not_mixed() -> None:
    picture = (np.random.default_rng(1).integers(0, 2, (20, 300, 1)) * 255).repeat(3, axis=2).astype(np.uint8)
    drawn = np.asarray(draw_panel(panel(picture, zoom=(3, 2))))
    inside = drawn[TITLE_HEIGHT : TITLE_HEIGHT + 40, LEFT : LEFT + 900]
    assert np.array_equal(inside, picture.repeat(2, axis=0).repeat(3, axis=1))


def test_ticks_mark_the_middle_of_their_cell_in_both_directions() -> None:
    forwards, backwards = Axis("line", 0, 100), Axis("line", 100, 0)
    assert forwards.ticks(1000, 90) == [(5 + 100 * i, str(10 * i)) for i in range(10)]
    assert sorted(backwards.ticks(1000, 90)) == sorted((994 - 100 * i, str(10 * i)) for i in range(10)) or all(
        abs(place - (995 - 10 * int(text))) <= 1 for place, text in backwards.ticks(1000, 90)
    )
    assert Axis("none", 0, 0).ticks(100, 10) == []


def test_ticks_of_places_are_exact_and_far_enough_apart() -> None:
    marks = Axis("x [m]", 650_300.2, 650_310.2, cells=False).ticks(1000, 120)
    assert marks[0] == (180, "650,302")
    places = [place for place, _ in marks]
    assert min(np.diff(places)) >= 120


@pytest.mark.parametrize(("width", "height"), [(2154, 99), (4270, 255), (389, 229), (16, 1), (1, 16), (2083, 64)])
def test_small_pictures_are_enlarged_and_large_ones_left_alone(width: int, height: int) -> None:
    across, down = zoom_for(width, height)
    assert across >= 1
    assert down >= 1
    assert width * across <= max(2200, width)
    assert height * down <= max(2200, height)


def test_sheets_hold_head_pictures_and_key() -> None:
    pictures = [panel(plain(99, 1200, 50)), panel(plain(99, 1200, 200), "second", bar=range_bar((2.0, 50.0)))]
    sheet = draw_sheet("what is shown", pictures, (("ground", (1, 2, 3)), ("car", (4, 5, 6))))
    column = [sheet.getpixel((LEFT + 600, y)) for y in range(sheet.height)]
    assert column.index((50, 50, 50)) < column.index((200, 200, 200))
    bottom = np.asarray(sheet)[-60:]
    for colour in ((1, 2, 3), (4, 5, 6)):
        assert (bottom == colour).all(axis=2).any()
    right = np.asarray(sheet)[:, LEFT + 1210 :]
    assert len(np.unique(right.reshape(-1, 3), axis=0)) > 60  # the colour bar


def test_the_key_of_a_picture_stands_below_it() -> None:
    key = (("ground", (1, 2, 3)), ("car", (4, 5, 6)))
    sheet = np.asarray(draw_sheet("", [panel(plain(300, 700)), panel(plain(300, 700), key=key)], columns=2))
    for _, colour in key:
        rows, columns = np.nonzero((sheet == colour).all(axis=2))
        assert columns.min() > sheet.shape[1] // 2
        assert rows.min() > 300
    alone = draw_panel(panel(plain(300, 700), key=key), with_title=False)
    assert not (np.asarray(alone) == key[0][1]).all(axis=2).any()  # pages with text write it themselves


@pytest.mark.parametrize(
    ("picture", "expected"),
    [
        (np.zeros((3, 4), np.uint8), r"grey: found uint8 of shape \(3, 4\), expected uint8"),
        (np.zeros((3, 4, 3)), "grey: found float64"),
        (np.zeros((0, 4, 3), np.uint8), "grey: found uint8 of shape"),
    ],
)
def test_what_is_no_picture(picture: U8, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        draw_panel(Panel("grey", picture, Axis("", 0, 1), Axis("", 0, 1)))
    with pytest.raises(InputError, match="pictures: found none, expected at least one"):
        draw_sheet("", [])


def test_a_page_holds_its_pictures_and_quotes_what_it_is_told() -> None:
    picture = panel(plain(10, 30, 77), "<b>title", caption="a & b")
    page = html_page("<script>", "head", [("", [picture]), ("more", [picture])], (("x<y", (1, 2, 3)),), "foot")
    assert "<script>" not in page
    assert "&lt;b&gt;title" in page
    assert "a &amp; b" in page
    assert "x&lt;y" in page
    assert not re.search(r"(src|href)=[\"'](?!data:)", page)
    data = re.findall(r"data:image/png;base64,([A-Za-z0-9+/=]+)", page)
    assert len(data) == 2
    with Image.open(io.BytesIO(base64.b64decode(data[0]))) as image:
        assert (np.asarray(image) == 77).all(axis=2).sum() >= 300
