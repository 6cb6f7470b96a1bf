"""Pixels, colours, scales and sheets; points in perspective and from above."""

from __future__ import annotations

import base64
import io
import math
import re

import numpy as np
import pytest
from PIL import Image

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, U8
from prc_cli.imaging.cloud import NARROWEST, DepthBuffer, FromAbove, Perspective, Sample
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


def box(n: int = 4000, seed: int = 1) -> F64:
    return np.random.default_rng(seed).uniform((-10, -5, 0), (10, 5, 4), (n, 3))


def test_a_sample_is_bounded_even_and_does_not_depend_on_the_chunks() -> None:
    rows = np.arange(10_000.0)[:, None]
    whole, parts = Sample(1, most=100), Sample(1, most=100)
    whole.add(rows)
    for first in range(0, len(rows), 37):
        parts.add(rows[first : first + 37])
    assert np.array_equal(whole.rows(), parts.rows())
    assert whole.n_seen == parts.n_seen == 10_000
    assert 50 <= len(whole.rows()) <= 100
    assert len(np.unique(np.diff(whole.rows()[:, 0]))) == 1
    assert Sample(3).rows().shape == (0, 3)


@pytest.mark.parametrize("azimuth", [0, 90, 215, -30])
@pytest.mark.parametrize("elevation", [-20, 0, 30, 89, 90])
def test_the_perspective_holds_the_points_upright(azimuth: float, elevation: float) -> None:
    points = box()
    view = Perspective.around(points, azimuth, elevation, 700, 500)
    right, down, depth = view.project(points)
    width, height = view.size
    inside = (right >= 0) & (right < width) & (down >= 0) & (down < height)
    assert inside.mean() > 0.85
    assert (depth > 0).all()
    assert width <= 700
    assert height <= 500
    if abs(elevation) < 80:
        up = view.project(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))[1]
        assert up[1] < up[0]
    # the eye stands where it was told to
    away = view.eye - (points.min(axis=0) + points.max(axis=0)) / 2
    assert math.degrees(math.asin(away[2] / np.linalg.norm(away))) == pytest.approx(elevation, abs=1.0)
    if abs(elevation) < 80:
        bearing = math.degrees(math.atan2(away[0], away[1]))
        assert (bearing - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=1.0)


def test_the_nearest_point_wins_whatever_the_order() -> None:
    view = FromAbove(0.0, 10.0, 20.0, 1.0, (10, 10))
    points = np.array([[4.5, 4.5, z] for z in (1.0, 9.0, 3.0)])
    colours = np.array([[10, 0, 0], [0, 20, 0], [0, 0, 30]], np.uint8)
    pictures = []
    for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
        buffer = DepthBuffer(view)
        for i in order:
            buffer.add(points[i : i + 1], colours[i : i + 1])
        pictures.append(buffer.picture(close=0, shade=False))
    assert pictures[0][5, 4].tolist() == [0, 20, 0]
    assert all(np.array_equal(pictures[0], other) for other in pictures)
    assert (pictures[0] == 255).all(axis=2).sum() == 99


@pytest.mark.parametrize("along", [0, 1])
def test_a_row_of_points_from_above_has_room_beside_it(along: int) -> None:
    """A picture of a straight drive is not one pixel wide."""
    points = np.zeros((100, 3))
    points[:, along] = np.linspace(0, 100, 100)
    width, height = FromAbove.around(points, 400, 400).size
    long, short = (width, height) if along == 0 else (height, width)
    assert long == 400
    assert short == pytest.approx(NARROWEST * 400, rel=0.05)
