"""``prc check``: what is drawn, what the page contains, and that a browser answers on it."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock, cut
from prc_cli.core.types import I64, U8
from prc_cli.evaluation.answers import CANNOT_TELL, Answers, load_answers
from prc_cli.jobs.check import CheckOptions, check
from prc_cli.jobs.check.draw import SURE, Drawn, draw
from prc_cli.jobs.check.surroundings import _turned
from prc_cli.jobs.evaluate.answers import evaluate_answers
from prc_cli.jobs.render.colours import RecordClasses, vocabulary
from prc_cli.jobs.render.options import RenderOptions
from tests.browser import Browser, chromium
from tests.simulated import drive_arrays

WORDS = vocabulary(RenderOptions(), ClassCodes())
N_LINES = 240
M = 300


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive, a label file with one shot of ten wrong, and its true labels."""
    folder = tmp_path_factory.mktemp("drive")
    block, labels = drive_arrays(N_LINES, M, 5)
    assert block.angle_rad is not None
    angle_deg = np.rad2deg(block.angle_rad)
    np.savez(folder / "drive.npz", range_m=block.range_m, angle_deg=angle_deg)
    random = np.random.default_rng(0)
    predicted = labels.copy()
    wrong = (labels != Label.MISSING) & (random.random(labels.shape) < 0.1)
    predicted[wrong] = Label.VEGETATION
    np.save(folder / "labels.npy", ClassCodes().lookup()[predicted].ravel())
    return folder / "drive.npz", folder / "labels.npy", labels


@pytest.fixture
def config():
    return load_config()


def about(page: Path) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    match = re.search(r'id="about">(.*?)</script>', text, re.DOTALL)
    assert match is not None
    table: dict[str, Any] = json.loads(match[1])
    return table


def drawn_from(
    labels: U8, cuts: list[int], n: int = 60, seed: int = 0, sure: U8 | None = None
) -> Drawn:
    """A sample of a stream of dense records, read in blocks that begin at some lines."""
    ranges = np.where(labels == Label.MISSING, np.nan, 5).astype(np.float32)
    whole = ScanBlock(0, ranges)
    ends = [*cuts[1:], len(labels)]
    blocks = [cut(whole, low, high) for low, high in zip(cuts, ends, strict=True)]
    classes = RecordClasses("x", labels.ravel())
    return draw(iter(blocks), WORDS, classes, sure, n, seed, lambda _: None)


def some_labels(shape: tuple[int, int] = (200, 90)) -> U8:
    random = np.random.default_rng(3)
    kinds = [Label.MISSING, Label.GROUND, Label.BUILDING, Label.CURB]
    return random.choice(kinds, shape, p=[0.3, 0.5, 0.19, 0.01]).astype(np.uint8)


def test_the_sample_does_not_depend_on_the_blocks():
    labels = some_labels()
    whole = drawn_from(labels, [0])
    assert drawn_from(labels, [0, 1, 7, 150]) == whole
    assert drawn_from(labels, [0], seed=1) != whole


def test_strata_count_every_shot_and_places_have_their_class():
    labels = some_labels()
    drawn = drawn_from(labels, [0, 50])
    counts = {stratum.predicted: stratum.n_shots for stratum in drawn.strata}
    for label in (Label.GROUND, Label.BUILDING, Label.CURB):
        assert counts[label.name.lower()] == np.count_nonzero(labels == label)
    assert len(set(drawn.places)) == len(drawn.places) == 60
    for place in drawn.places:
        name = Label(int(labels[place.line, place.column])).name.lower()
        assert drawn.strata[place.stratum].predicted == name
        assert place.record == place.line * labels.shape[1] + place.column


def test_a_larger_sample_contains_the_smaller_one():
    labels = some_labels()
    small = {place[:3] for place in drawn_from(labels, [0], n=40).places}
    assert small <= {place[:3] for place in drawn_from(labels, [0], n=120).places}


def test_every_beginning_of_the_sample_has_all_strata():
    drawn = drawn_from(some_labels(), [0], n=90)
    assert {place.stratum for place in drawn.places[:12]} == {0, 1, 2}


def test_every_shot_of_a_stratum_has_the_same_chance():
    labels = np.full((10, 10), Label.GROUND, np.uint8)
    drawn: I64 = np.zeros(labels.shape, np.int64)
    for seed in range(400):
        for place in drawn_from(labels, [0, 4], n=10, seed=seed).places:
            drawn[place.line, place.column] += 1
    # 40 times each in the mean; the sum of squares follows chi-square with 99 degrees
    assert drawn.sum() == 4_000
    assert ((drawn - 40.0) ** 2 / 36.0).sum() < 160


def test_confidence_divides_the_classes():
    labels = some_labels()
    sure = np.where(np.arange(labels.size) % 5 == 0, SURE - 1, SURE).astype(np.uint8)
    drawn = drawn_from(labels, [0], sure=sure)
    assert [(stratum.predicted, stratum.low, stratum.high) for stratum in drawn.strata] == [
        (name, *bounds)
        for name in ("ground", "building", "curb")
        for bounds in ((0, SURE - 1), (SURE, 100))
    ]
    for place in drawn.places:
        assert (sure[place.record] >= SURE) == (drawn.strata[place.stratum].low == SURE)


def test_the_page_has_every_place_and_nothing_else(drive, config, tmp_path):
    page = tmp_path / "check.html"
    result = check(drive[0], page, config, CheckOptions(shots=50, labels=drive[1]))
    text = page.read_text(encoding="utf-8")
    table = about(page)
    answers = Answers.model_validate(table["answers"])
    assert result.n_places == len(answers.places) == len(table["places"])
    assert sum(stratum.n_shots for stratum in answers.strata) == np.count_nonzero(drive[2])
    assert all(place.answer is None for place in answers.places)
    assert table["file"] == result.answers == "labels_answers.json"
    assert not re.search(r"(src|href)=|https?://", text)
    for place in table["places"]:
        assert place["points"] > 1_000


def test_the_scanner_turns_with_the_points_of_its_line():
    sensor = np.array([[1, 0, 0], [0, 2, 0], [3, 0, 1]], np.float32)
    a_quarter = sensor[:, [1, 0, 2]] * (-1, 1, 1)
    placed = np.add(a_quarter, (100, 50, 0)).astype(np.float32)
    turned = _turned(sensor, placed, np.array([2.0, 0.0, 1.0]))
    np.testing.assert_allclose(turned, (0, 2, 1), atol=1e-9)


def answered(page: Path, labels: U8, target: Path) -> Path:
    """Write the answers of a person who knows the truth."""
    table = about(page)["answers"]
    for place in table["places"]:
        name = Label(int(labels[place["line"], place["column"]])).name.lower()
        place["answer"] = name if name in table["classes"] else "other"
    target.write_text(json.dumps(table))
    return target


def test_true_answers_give_scores_near_the_truth(drive, config, tmp_path):
    page = tmp_path / "check.html"
    check(drive[0], page, config, CheckOptions(shots=150, labels=drive[1]))
    answers = answered(page, drive[2], tmp_path / "a.json")
    accuracy = evaluate_answers(drive[1], [answers]).scores["accuracy"]
    seen = drive[2][drive[2] != Label.MISSING]
    codes = np.load(drive[1])[drive[2].ravel() != Label.MISSING]
    right = (codes == ClassCodes().lookup()[seen]) & (seen != Label.UNCLASSIFIED)
    assert accuracy.low < right.mean() < accuracy.high
    assert accuracy.high - accuracy.low < 0.15
    with pytest.raises(InputError, match=r"answers about labels.npy, expected drive.npz"):
        evaluate_answers(drive[0], [answers])


def press(browser: Browser, key: str) -> None:
    """Press a key, and wait for the place that the page shows then."""
    browser.run(f"dispatchEvent(new KeyboardEvent('keydown', {{key: {key!r}, bubbles: true}}))")


@pytest.mark.slow
def test_a_browser_answers_by_keys_saves_and_loads(drive, config, tmp_path):
    """Answered by keys, undone, kept when the page is closed, saved, loaded, evaluated."""
    page = tmp_path / "check.html"
    check(drive[0], page, config, CheckOptions(shots=20, labels=drive[1]))
    table = about(page)["answers"]
    classes: list[str] = table["classes"]
    n = len(table["places"])
    with chromium() as browser:
        browser.devtools(
            "Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path)
        )
        for width, dark in ((1280, False), (390, True)):
            browser.open(page, width=width, dark=dark)
            browser.wait("document.body.dataset.place === '0'")
            browser.settle()
            assert browser.run("return document.documentElement.scrollWidth") <= width
            for canvas in ("cloud", "wide", "near"):
                script = (
                    f"const c = document.getElementById('{canvas}');"
                    "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
                    "return new Set(new Uint32Array(d.buffer)).size"
                )
                assert browser.run(script) > 10
        press(browser, "?")
        browser.wait("document.body.dataset.place === '1'")
        press(browser, "Backspace")
        browser.wait("document.body.dataset.place === '0'")
        for number, place in enumerate(table["places"]):
            browser.wait(f"document.body.dataset.place === '{number}'")
            name = Label(int(drive[2][place["line"], place["column"]])).name.lower()
            key = str(classes.index(name) + 1) if name in classes else "o"
            press(browser, key if number else "0")
        browser.wait(f"document.body.dataset.answered === '{n}'")
        # closed and opened again
        browser.open(page)
        browser.wait(f"document.body.dataset.answered === '{n}'")
        press(browser, "s")
        saved = tmp_path / "labels_answers.json"
        browser.wait("document.getElementById('state').textContent.startsWith('Saved')")
        end = 100
        while not saved.exists() and end:
            browser.settle()
            end -= 1
        answers = load_answers(saved)
        # an empty browser gets the answers from the file
        browser.run("localStorage.clear()")
        browser.open(page)
        browser.wait("document.body.dataset.answered === '0'")
        load = (
            "const files = new DataTransfer();"
            f"files.items.add(new File([{json.dumps(saved.read_text())}], 'a.json'));"
            "const node = document.getElementById('load'); node.files = files.files;"
            "node.dispatchEvent(new Event('change'))"
        )
        browser.run(load)
        browser.wait(f"document.body.dataset.answered === '{n}'")
        assert browser.errors() == []
    assert answers.places[0].answer == CANNOT_TELL
    evaluation = evaluate_answers(drive[1], [saved])
    assert evaluation.pooled.n_open == 0
    assert evaluation.pooled.sample.n_unsure.sum() == 1
    assert evaluation.scores["accuracy"].value > 0.5
