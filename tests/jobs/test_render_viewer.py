"""``prc render --html``: which shots the page holds, where it puts them, and that a browser shows them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.jobs.classify import classify
from prc_cli.jobs.render import RenderOptions
from prc_cli.jobs.render.viewer import _Kept, render_viewer
from tests.browser import chromium
from tests.imaging.test_viewer import decoded
from tests.jobs.test_render import drive as drive
from tests.jobs.test_render import static as static
from tests.jobs.test_render import urban as urban
from tests.street import N_LINES, POINTS_PER_LINE, street, write_npz


def read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def test_classes_and_ranges_of_a_drive(tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    config = load_config(preset="urban")
    result = render_viewer(source, tmp_path / "a.html", config)
    about, planes = decoded(read(tmp_path / "a.html"))
    classify(source, tmp_path / "labels.npy", config)
    codes = np.load(tmp_path / "labels.npy").reshape(N_LINES, POINTS_PER_LINE)
    lookup = ClassCodes().lookup()
    assert np.array_equal(lookup[np.nan_to_num(planes["class"]).astype(int)], codes)
    assert np.allclose(planes["range"], np.where(codes > 0, street(), np.nan), atol=0.001, equal_nan=True)
    assert result.counts is not None
    assert {one["name"]: one["place"] for one in about["classes"]}["ground"] == Label.GROUND
    assert (result.lines, result.thinned_by) == ((0, N_LINES), (1, 1))
    assert "preset urban · all" in result.drawn
    # a result beside its input is shown, not made again
    given = RenderOptions(labels=tmp_path / "labels.npy")
    render_viewer(source, tmp_path / "b.html", config, given)
    assert np.array_equal(decoded(read(tmp_path / "b.html"))[1]["class"], planes["class"], equal_nan=True)


def test_a_static_scan_is_where_it_was_measured_and_stages_are_shown(static: tuple[Path, Path], tmp_path: Path) -> None:
    config = load_config(preset="street-scan")
    render_viewer(static[0], tmp_path / "a.html", config, RenderOptions(hide=("vegetation",)))
    about, planes = decoded(read(tmp_path / "a.html"))
    with np.load(static[0]) as scan:
        seen = np.isfinite(planes["x"])
        assert seen.mean() > 0.3
        for k, axis in enumerate("xyz"):
            assert np.allclose(planes[axis][seen], scan["xyz"][..., k][seen], atol=0.01)
    assert {"surface", "dense_vegetation", "ground_height", "height_above_ground"} <= set(planes)
    assert about["planes"]["surface"]["words"]["3"] == "vertical"
    assert [one["name"] for one in about["classes"] if one["hidden"]] == ["vegetation"]
    # the values of a result that was written with its stages
    stages = load_config(preset="street-scan", options={"output": {"stages": True}})
    classify(static[0], tmp_path / "out.csv", stages)
    render_viewer(static[0], tmp_path / "b.html", config, RenderOptions(labels=tmp_path / "out.csv"))
    again = decoded(read(tmp_path / "b.html"))[1]
    assert np.array_equal(again["class"], planes["class"], equal_nan=True)
    assert np.allclose(again["height_above_ground"], planes["height_above_ground"], atol=0.002, equal_nan=True)
    assert np.array_equal(again["surface"], planes["surface"], equal_nan=True)


@pytest.mark.slow
def test_a_browser_shows_the_shots(static: tuple[Path, Path], tmp_path: Path) -> None:
    """Drawn, clicked, steered by keys, classes switched off; light and dark, wide and narrow; without a complaint."""
    page = tmp_path / "a.html"
    render_viewer(static[0], page, load_config(preset="street-scan"))
    about, planes = decoded(read(page))
    drawn = (
        "const c = document.getElementById('{}'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        "const seen = new Set(); for (let i = 0; i < d.length; i += 4) seen.add(d[i] << 16 | d[i + 1] << 8 | d[i + 2]);"
        "return seen.size"
    )
    with chromium() as browser:
        for width, dark in ((1280, False), (390, True)):
            browser.open(page, width=width, dark=dark)
            browser.wait("document.body.dataset.ready")
            assert int(browser.run("return document.body.dataset.ready")) == np.isfinite(planes["x"]).sum()
            browser.settle()
            assert browser.run(drawn.format("cloud")) > 20
            assert browser.run(drawn.format("image")) > 3
            assert browser.run("return document.documentElement.scrollWidth") <= width
        line, column = np.argwhere(np.isfinite(planes["x"]))[0]
        browser.run(f"location.hash = '{line},{column}'")
        browser.wait("document.querySelectorAll('#shot dd').length > 3")
        shown = browser.run("return Array.from(document.querySelectorAll('#shot dd'), (each) => each.textContent)")
        assert shown[:2] == [str(line), str(column)]
        assert f"{planes['range'][line, column]:.3f} m" in shown
        why = browser.run("return document.querySelector('#why').textContent")
        assert why == f"Why this class? prc explain static.npz --preset street-scan --at {line},{column}"
        names = {one["place"]: one["name"] for one in about["classes"]}
        assert shown[2] == names[int(planes["class"][line, column])]
        press = "document.getElementById('image').dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight'}))"
        browser.run(press.replace("ArrowRight", "ArrowLeft") if about["mirrored"] else press)
        browser.wait(f"document.querySelector('#shot dd').textContent !== '{line}'")
        browser.click("#image")
        browser.wait(f"document.querySelector('#shot dd').textContent > {line + 5}")
        browser.run("document.querySelectorAll('#legend input').forEach((each) => each.click())")
        browser.settle()
        empty = (
            "const c = document.getElementById('image');"
            "const d = new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer);"
            "return d.filter((one) => one === d[0]).length / d.length"
        )
        assert browser.run(empty) > 0.98
        assert browser.errors() == []


def test_what_only_some_blocks_have_is_not_shown() -> None:
    kept = _Kept.__new__(_Kept)
    kept.parts = {"range": [np.ones(3), np.ones(2)], "time": [np.ones(3)], "class": [np.ones(3), np.zeros(2)]}
    assert kept.take("time") is None
    found = kept.take("class")
    assert found is not None
    assert found.tolist() == [1, 1, 1, 0, 0]
