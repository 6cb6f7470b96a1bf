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
from prc_cli.imaging.pictures import segment_picture
from prc_cli.imaging.sheet import Axis, Panel, draw_panel, draw_sheet, zoom_for
from prc_cli.imaging.viewer import html_page


def test_segments_differ_are_stable_and_none_is_black() -> None:
    ids = np.arange(0, 500).reshape(1, -1)
    picture = segment_picture(ids)
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert len(np.unique(picture[0], axis=0)) > 490
    assert picture[0, 1:].max(axis=1).min() > 85
    assert np.array_equal(segment_picture(ids[:, 100:110])[0], picture[0, 100:110])
    assert segment_picture(np.array([[2**62]])).any()


def plain(height: int, width: int, colour: int = 90) -> U8:
    return np.full((height, width, 3), colour, dtype=np.uint8)


def panel(picture: U8, title: str = "range", **options: object) -> Panel:
    x, y = Axis("column", 0, picture.shape[1]), Axis("line", 0, picture.shape[0])
    return Panel(title, picture, x, y, **options)  # type: ignore[arg-type]


def test_ticks_mark_the_middle_of_their_cell_in_both_directions() -> None:
    forwards, backwards = Axis("line", 0, 100), Axis("line", 100, 0)
    assert forwards.ticks(1000, 90) == [(5 + 100 * i, str(10 * i)) for i in range(10)]
    assert sorted(backwards.ticks(1000, 90)) == sorted((994 - 100 * i, str(10 * i)) for i in range(10)) or all(
        abs(place - (995 - 10 * int(text))) <= 1 for place, text in backwards.ticks(1000, 90)
    )
    assert Axis("none", 0, 0).ticks(100, 10) == []


@pytest.mark.parametrize(("width", "height"), [(2154, 99), (4270, 255), (389, 229), (16, 1), (1, 16), (2083, 64)])
def test_small_pictures_are_enlarged_and_large_ones_left_alone(width: int, height: int) -> None:
    across, down = zoom_for(width, height)
    assert across >= 1
    assert down >= 1
    assert width * across <= max(2200, width)
    assert height * down <= max(2200, height)


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
