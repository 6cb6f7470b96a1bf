"""Labels by hand in both pages: painted in a browser, saved, loaded, evaluated."""

import json
from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes
from prc_cli.core.types import U8
from prc_cli.evaluation.scores import scores
from prc_cli.formats.labels import labelled_records
from prc_cli.jobs.check import CheckOptions, check
from prc_cli.jobs.evaluate import evaluate_all
from prc_cli.jobs.render.options import RenderOptions
from prc_cli.jobs.render.viewer import render_viewer
from tests.browser import Browser, chromium
from tests.simulated import drive_arrays

READY = {
    "viewer": ("#image", "document.body.dataset.ready"),
    "check": ("#near", "document.body.dataset.place === '0'"),
}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive, its true labels as a file, and their codes."""
    folder = tmp_path_factory.mktemp("drive")
    block, labels = drive_arrays(160, 200, 5)
    assert block.angle_rad is not None
    angle_deg = np.rad2deg(block.angle_rad)
    np.savez(folder / "drive.npz", range_m=block.range_m, angle_deg=angle_deg)
    codes = ClassCodes().lookup()[labels].ravel()
    np.save(folder / "labels.npy", codes)
    return folder / "drive.npz", folder / "labels.npy", codes


def written(kind: str, drive: tuple[Path, Path, U8], page: Path) -> Path:
    if kind == "viewer":
        render_viewer(drive[0], page, load_config(), RenderOptions(labels=drive[1]))
    else:
        check(drive[0], page, load_config(), CheckOptions(shots=20, labels=drive[1]))
    return page


def press(browser: Browser, key: str) -> None:
    browser.run(f"dispatchEvent(new KeyboardEvent('keydown', {{key: {key!r}, bubbles: true}}))")


def place(browser: Browser, canvas: str, across: float, down: float) -> dict[str, float]:
    """Return the pixel of a place in a canvas, as shares of its size."""
    x, y, width, height = browser.run(
        f"const r = document.querySelector('{canvas}').getBoundingClientRect();"
        "return [r.x, r.y, r.width, r.height]"
    )
    return {"x": x + across * width, "y": y + down * height}


def drag(browser: Browser, canvas: str, *places: tuple[float, float]) -> None:
    """Press the mouse at the first place, and release it at the last."""
    for number, (across, down) in enumerate(places):
        point = place(browser, canvas, across, down)
        kind = "mouseMoved" if number else "mousePressed"
        browser.devtools("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, **point)
    browser.devtools("Input.dispatchMouseEvent", type="mouseReleased", button="left", **point)


def n_painted(browser: Browser) -> int:
    return int(browser.run("return document.body.dataset.painted"))


def saved_rows(path: Path) -> list[list[str]]:
    return [line.split(",") for line in path.read_text().splitlines()[2:]]


def save(browser: Browser, target: Path) -> None:
    press(browser, "s")
    for _ in range(100):
        browser.settle()
        if target.exists():
            return


def load(browser: Browser, path: Path) -> None:
    """Empty the page and the browser, and load a file."""
    while not browser.run("return document.getElementById('paint-undo').disabled"):
        press(browser, "z")
    browser.run("localStorage.clear()")
    browser.run(
        "const files = new DataTransfer();"
        f"files.items.add(new File([{json.dumps(path.read_text())}], 'a.csv'));"
        "const node = document.getElementById('paint-load'); node.files = files.files;"
        "node.dispatchEvent(new Event('change'))"
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["viewer", "check"])
def test_labels_are_painted_saved_loaded_and_evaluated(kind, drive, tmp_path):
    """By mouse, keys and touch; undone, done again, erased, kept when the page is closed."""
    page = written(kind, drive, tmp_path / "page.html")
    canvas, ready = READY[kind]
    saved = tmp_path / "labels_labels.csv"
    with chromium() as browser:
        browser.devtools(
            "Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path)
        )
        browser.open(page)
        browser.wait(ready)
        drag(browser, canvas, (0.3, 0.5), (0.4, 0.5))
        assert n_painted(browser) == 0
        press(browser, "p")
        press(browser, "2")
        # brush, undo and redo
        drag(browser, canvas, (0.3, 0.5), (0.4, 0.55), (0.6, 0.5))
        brushed = n_painted(browser)
        assert brushed > 0
        press(browser, "z")
        assert n_painted(browser) == 0
        press(browser, "y")
        assert n_painted(browser) == brushed
        # a polygon by clicks and Enter
        press(browser, "6")
        press(browser, "g")
        for corner in ((0.1, 0.3), (0.9, 0.3), (0.9, 0.7), (0.1, 0.7)):
            drag(browser, canvas, corner)
        press(browser, "Enter")
        assert n_painted(browser) > 2 * brushed
        # the eraser takes labels away, also by the key at the cursor
        press(browser, "z")
        press(browser, "e")
        press(browser, "b")
        drag(browser, canvas, (0.3, 0.5), (0.4, 0.55))
        erased = n_painted(browser)
        assert 0 < erased < brushed
        # a finger
        browser.open(page, width=390, dark=True)
        browser.wait(ready)
        assert n_painted(browser) == erased
        press(browser, "p")
        press(browser, "2")
        browser.settle()
        assert browser.run("return document.documentElement.scrollWidth") <= 390
        for touch, down in (("touchStart", 0.2), ("touchMove", 0.8)):
            points = [place(browser, canvas, 0.8, down)]
            browser.devtools("Input.dispatchTouchEvent", type=touch, touchPoints=points)
        browser.devtools("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        painted = n_painted(browser)
        assert painted > erased
        save(browser, saved)
        load(browser, saved)
        browser.wait(f"document.body.dataset.painted === '{painted}'")
        # the flood stays within the ranges that are alike
        press(browser, "f")
        drag(browser, canvas, (0.5, 0.9))
        assert n_painted(browser) >= painted
        assert browser.errors() == []
    rows = saved_rows(saved)
    assert len(rows) == painted
    assert labelled_records(saved) == len(drive[2])
    records = np.array([int(row[0]) for row in rows])
    assert (drive[2][records] != 0).all()
    evaluation = evaluate_all([drive[1]], [saved])
    assert evaluation.match.n_matched == painted
    right = scores(evaluation.matrix).accuracy
    # curbs are ground in this mapping
    assert right == pytest.approx(np.isin(drive[2][records], (2, 66)).mean(), abs=0.02)


@pytest.mark.parametrize(
    "head, n_records",
    [
        ("# labels by hand: a.laz, 12 records", 12),
        ("# labels by hand: a, b.laz", 0),
        ("record,class", None),
    ],
)
def test_the_first_line_says_what_was_labelled(head, n_records, tmp_path):
    (tmp_path / "a.csv").write_text(f"{head}\nrecord,class,class_name\n3,2,ground\n")
    assert labelled_records(tmp_path / "a.csv") == n_records
