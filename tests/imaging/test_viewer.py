"""The page of ``prc render --html``: its data decode to the shots, and nothing in it reaches outside."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from typing import Any

import numpy as np

from prc_cli.core.types import F64
from prc_cli.imaging.viewer import ClassEntry, Shots, Values, viewer_page

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
    entries = [ClassEntry(1, "</script><i>", (1, 2, 3), "1 %"), ClassEntry(2, "ground", (4, 5, 6), "99 %", True)]
    more = {
        "time": Values("time", 1e5 + np.arange(63.0).reshape(7, 9) * 1e-4, 1e-7, 4, "s", False),
        "surface": Values("coarse class", classes.astype(float), 1.0, 1, "", words={1: "vertical"}),
    }
    return Shots(classes, range_m, xyz, classes > 0, (100, 0), (2, 3), entries, more, tuple(range(8, -1, -1)), True)


def decoded(page: str) -> tuple[dict[str, Any], dict[str, F64]]:
    """Return what the page says of itself, and its planes as the script reads them; 0 is NaN."""
    found = re.search(r'<script type="application/json" id="about">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    about = json.loads(found[1])
    planes = {}
    for name, plane in about["planes"].items():
        text = re.search(rf'<script type="text/plain" id="plane-{name}">([A-Za-z0-9+/=]+)</script>', page)
        assert text is not None
        whole = unpack(text[1], plane["bytes"])
        assert len(whole) == plane["n"]
        values = plane.get("offset", 1.0) + plane.get("scale", 1.0) * (whole - 1.0)
        planes[name] = np.where(whole > 0, values, np.nan).reshape(about["lines"]["n"], about["columns"]["n"])
    return about, planes


def page_of(given: Shots) -> str:
    return viewer_page(given, title=TITLE, head="all & more", notes=["1 < 2"], foot="prc")


def test_the_data_of_the_page_are_the_shots() -> None:
    given = shots()
    about, planes = decoded(page_of(given))
    assert np.array_equal(np.nan_to_num(planes["class"]), given.classes)
    assert np.allclose(planes["range"], given.range_m, atol=0.000_51, equal_nan=True)
    assert given.xyz_m is not None
    far = np.zeros((7, 9), bool)
    far[4, 4] = True
    for k, axis in enumerate("xyz"):
        expected = np.where(far, np.nan, given.xyz_m[..., k])
        assert np.allclose(planes[axis], expected, atol=0.001, rtol=0, equal_nan=True)
    assert np.allclose(planes["time"], given.more["time"].values, atol=1e-7, rtol=0)
    assert about["planes"]["surface"]["words"] == {"1": "vertical"}
    assert about["lines"] == {"n": 7, "first": 100, "step": 2}
    assert about["columns"] == {"n": 9, "first": 0, "step": 3}
    assert [one["name"] for one in about["classes"] if one["hidden"]] == ["ground"]
    assert about["order"][0] == 8
    assert about["mirrored"] is True
    assert len(about["ramp"]) == 256


def test_the_page_is_escaped_and_runs_nothing_but_its_own_script() -> None:
    page = page_of(shots())
    assert "<i>" not in page
    assert "<b>" not in page
    assert "1 &lt; 2" in page
    assert "http" not in page.replace("http-equiv", "")
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page)
    assert policy.startswith("default-src 'none'; ")
    for kind, text in (("script", page.rsplit("<script>", 1)[1].split("</script>")[0]),
                       ("style", page.split("<style>")[1].split("</style>")[0])):  # fmt: skip
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in policy
    assert " style=" not in page
    assert not re.search(r"\son\w+=", page)
    assert page == page_of(shots())


def test_a_scan_without_returns_is_a_page_all_the_same() -> None:
    nothing = np.full((2, 3), np.nan)
    given = Shots(
        np.zeros((2, 3), np.uint8), nothing, np.full((2, 3, 3), np.nan), np.zeros((2, 3), bool), (0, 0), (1, 1), ()
    )
    _, planes = decoded(page_of(given))
    assert all(np.isnan(plane).all() for plane in planes.values())


def unpack(text: str, n_bytes: int) -> Any:
    """Return the integers as the page decodes them."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(n_bytes, -1).astype(np.int64)
    steps = sum(planes[k] << (8 * k) for k in range(n_bytes))
    return np.cumsum(steps) % 256**n_bytes
