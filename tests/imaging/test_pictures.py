"""Pixels, colours, scales and sheets.

Points in perspective and from above; the page of ``prc render IN OUT.html``.
"""

import base64
import hashlib
import json
import math
import re
import zlib
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64
from prc_cli.imaging.cloud import NARROWEST, DepthBuffer, FromAbove, Perspective, Sample
from prc_cli.imaging.page import HandLabels, PaintedClass
from prc_cli.imaging.pictures import segment_picture, value_bar
from prc_cli.imaging.sheet import Axis, Panel, draw_panel, draw_sheet
from prc_cli.imaging.viewer import ClassEntry, Shots, Values, viewer_page


def test_segments_differ_are_stable_and_none_is_black():
    ids = np.arange(0, 500).reshape(1, -1)
    picture = segment_picture(ids)
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert len(np.unique(picture[0], axis=0)) > 490
    assert picture[0, 1:].max(axis=1).min() > 85
    assert np.array_equal(segment_picture(ids[:, 100:110])[0], picture[0, 100:110])
    assert segment_picture(np.array([[2**62]])).any()


@pytest.mark.parametrize(
    "picture, expected",
    [
        (np.zeros((3, 4), np.uint8), r"grey: found uint8 of shape \(3, 4\), expected uint8"),
        (np.zeros((3, 4, 3)), "grey: found float64"),
        (np.zeros((0, 4, 3), np.uint8), "grey: found uint8 of shape"),
    ],
)
def test_what_is_no_picture(picture, expected):
    with pytest.raises(InputError, match=expected):
        draw_panel(Panel("grey", picture, Axis("", 0, 1), Axis("", 0, 1)))
    with pytest.raises(InputError, match="pictures: found none, expected at least one"):
        draw_sheet("", [])


def box(n: int = 4000, seed: int = 1) -> F64:
    return np.random.default_rng(seed).uniform((-10, -5, 0), (10, 5, 4), (n, 3))


def test_a_sample_is_bounded_even_and_does_not_depend_on_the_chunks():
    rows = np.arange(10_000.0)[:, None]
    whole = Sample(1, most=100)
    parts = Sample(1, most=100)
    whole.add(rows)
    for first in range(0, len(rows), 37):
        parts.add(rows[first : first + 37])
    assert np.array_equal(whole.rows(), parts.rows())
    assert whole.n_seen == parts.n_seen == 10_000
    assert 50 <= len(whole.rows()) <= 100
    assert len(np.unique(np.diff(whole.rows()[:, 0]))) == 1
    assert Sample(3).rows().shape == (0, 3)


@pytest.mark.parametrize("azimuth, elevation", [(0, 30), (215, -20), (-30, 89), (90, 90)])
def test_the_perspective_holds_the_points_upright(azimuth, elevation):
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
    assert math.degrees(math.asin(away[2] / np.linalg.norm(away))) == pytest.approx(
        elevation, abs=1.0
    )
    if abs(elevation) < 80:
        bearing = math.degrees(math.atan2(away[0], away[1]))
        assert (bearing - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=1.0)


def test_the_nearest_point_wins_whatever_the_order():
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
    assert all(np.array_equal(pictures[0], picture) for picture in pictures)
    assert (pictures[0] == 255).all(axis=2).sum() == 99


@pytest.mark.parametrize("along", [0, 1])
def test_a_row_of_points_from_above_has_room_beside_it(along):
    """A picture of a straight drive is not one pixel wide."""
    points = np.zeros((100, 3))
    points[:, along] = np.linspace(0, 100, 100)
    width, height = FromAbove.around(points, 400, 400).size
    long, short = (width, height) if along == 0 else (height, width)
    assert long == 400
    assert short == pytest.approx(NARROWEST * 400, rel=0.05)


TITLE = "a <b>&\"'</script>.laz"


def shots() -> Shots:
    rng = np.random.default_rng(1)
    range_m = rng.uniform(1, 120, (7, 9))
    range_m[2, 3] = np.nan
    classes = rng.integers(1, 4, (7, 9)).astype(np.uint8)
    classes[2, 3] = 0
    xyz = rng.uniform(-20, 20, (7, 9, 3)) + np.array([650_000, 6_860_000, 40])
    xyz[2, 3] = np.nan
    xyz[4, 4] = (0, 0, 0)
    entries = [
        ClassEntry(1, "</script><i>", (1, 2, 3), "1 %"),
        ClassEntry(2, "ground", (4, 5, 6), "99 %", True),
    ]
    more = {
        "time": Values("time", 1e5 + np.arange(63.0).reshape(7, 9) * 1e-4, 1e-7, 4, "s", False),
        "surface": Values("coarse class", classes.astype(float), 1.0, 1, "", words={1: "vertical"}),
    }
    return Shots(
        classes,
        range_m,
        xyz,
        classes > 0,
        (100, 0),
        (2, 3),
        entries,
        more,
        tuple(range(8, -1, -1)),
        True,
    )


def decoded(page: str) -> tuple[dict[str, Any], dict[str, F64]]:
    """Return what the page says of itself, and its planes as the script reads them; 0 is NaN."""
    match = re.search(r'<script type="application/json" id="about">(.*?)</script>', page, re.DOTALL)
    assert match is not None
    about = json.loads(match[1])
    planes = {}
    for name, plane in about["planes"].items():
        text = re.search(
            rf'<script type="text/plain" id="plane-{name}">([A-Za-z0-9+/=]+)</script>', page
        )
        assert text is not None
        whole = unpack(text[1], plane["bytes"])
        assert len(whole) == plane["n"]
        values = plane.get("offset", 1.0) + plane.get("scale", 1.0) * (whole - 1.0)
        planes[name] = np.where(whole > 0, values, np.nan).reshape(
            about["lines"]["n"], about["columns"]["n"]
        )
    return about, planes


def page_of(scan: Shots) -> str:
    labels = HandLabels([PaintedClass(2, "ground", (1, 2, 3))], "", "a", None, "a.csv", "prc")
    return viewer_page(
        scan, title=TITLE, head="all & more", notes=["1 < 2"], foot="prc", labels=labels
    )


def test_the_data_of_the_page_are_the_shots():
    scan = shots()
    about, planes = decoded(page_of(scan))
    assert np.array_equal(np.nan_to_num(planes["class"]), scan.classes)
    assert np.allclose(planes["range"], scan.range_m, atol=0.000_51, equal_nan=True)
    assert scan.xyz_m is not None
    far = np.zeros((7, 9), bool)
    far[4, 4] = True
    for k, axis in enumerate("xyz"):
        expected = np.where(far, np.nan, scan.xyz_m[..., k])
        assert np.allclose(planes[axis], expected, atol=0.001, rtol=0, equal_nan=True)
    assert np.allclose(planes["time"], scan.more["time"].values, atol=1e-7, rtol=0)
    assert about["planes"]["surface"]["words"] == {"1": "vertical"}
    assert about["lines"] == {"n": 7, "first": 100, "step": 2}
    assert about["columns"] == {"n": 9, "first": 0, "step": 3}
    assert [entry["name"] for entry in about["classes"] if entry["hidden"]] == ["ground"]
    assert about["order"][0] == 8
    assert about["mirrored"] is True
    # one shot lies far away, and the page looks at the others
    np.testing.assert_allclose(about["box"]["centre"], (650_000, 6_860_000, 40), atol=10)
    assert len(about["ramp"]) == 256


def test_the_page_is_escaped_and_runs_nothing_but_its_own_script():
    page = page_of(shots())
    assert "<i>" not in page
    assert "<b>" not in page
    assert "1 &lt; 2" in page
    assert "http" not in page.replace("http-equiv", "")
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page)
    assert policy.startswith("default-src 'none'; ")
    for kind, text in (
        ("script", page.rsplit("<script>", 1)[1].split("</script>")[0]),
        ("style", page.split("<style>")[1].split("</style>")[0]),
    ):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in policy
    assert " style=" not in page
    assert not re.search(r"\son\w+=", page)
    assert page == page_of(shots())


def test_a_scan_without_returns_is_a_page_all_the_same():
    nothing = np.full((2, 3), np.nan)
    scan = Shots(
        np.zeros((2, 3), np.uint8),
        nothing,
        np.full((2, 3, 3), np.nan),
        np.zeros((2, 3), bool),
        (0, 0),
        (1, 1),
        (),
    )
    _, planes = decoded(page_of(scan))
    assert all(np.isnan(plane).all() for plane in planes.values())


def unpack(text: str, n_bytes: int) -> Any:
    """Return the integers as the page decodes them."""
    planes = (
        np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
        .reshape(n_bytes, -1)
        .astype(np.int64)
    )
    steps = sum(planes[k] << (8 * k) for k in range(n_bytes))
    return np.cumsum(steps) % 256**n_bytes


def test_a_bar_has_three_to_seven_even_values():
    for limits, labels in (((0.0, 60.0), "0 10 20 30 40 50 60"), ((0.0, 0.7), "0 0.2 0.4 0.6")):
        assert [label for _, label in value_bar(limits, "m").ticks] == labels.split()
