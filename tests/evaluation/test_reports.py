"""Reports as text and HTML."""

import json
from html.parser import HTMLParser

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.html import as_html
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.evaluation.reports import (
    as_csv,
    as_dict,
)
from prc_cli.evaluation.scores import OVERALL_SCORES, Evaluation, Gate, check_gates, scores
from tests.evaluation import samples

MATRIX = ConfusionMatrix(
    ("ground", "building", "stem", "other"),
    ("ground", "building", "stem", "unclassified"),
    np.array([[90, 10, 0, 0], [30, 70, 0, 0], [0, 0, 0, 0], [2, 0, 0, 0]]),
    n_ignored=5,
)


def test_reports_show_every_score_and_the_page_says_what_it_means():
    evaluation = samples.evaluation()
    page = as_html(evaluation)
    header = as_csv(evaluation).splitlines()[0].split(",")
    overall = as_dict(evaluation)["overall"]
    for name, meaning in OVERALL_SCORES.items():
        assert meaning
        assert meaning in page
        assert name in header
        assert name in overall


VOID = {"meta", "input", "img", "br", "link"}
PNG = b"\x89PNG\r\n\x1a\nrest"
NASTY_NAME = "</script><script>alert(1)</script>'\"&<b>.npy"


class Page(HTMLParser):
    """Checks that every element is closed in its order; keeps visible text and attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.words: list[str] = []
        self.data = ""
        self.attributes: list[tuple[str, str | None]] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len({name for name, _ in attrs}) == len(attrs), tag
        self.seen.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "script" in self.open:
            self.data += data
        elif "style" not in self.open:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.words)


def full_page() -> tuple[Evaluation, str]:
    evaluation = samples.evaluation()
    gates = check_gates(
        scores(evaluation.matrix), [Gate("recall.ground", 0.99), Gate("recall.stem", 0.1)]
    )
    pictures = [("Predicted", PNG)]
    return evaluation, as_html(
        evaluation, gates, mapping=load_mapping("oakland"), pictures=pictures
    )


def test_page_is_well_formed_and_needs_nothing_else():
    _, text = full_page()
    page = Page(text)
    assert text.startswith("<!DOCTYPE html>")
    assert not {"link", "iframe", "object", "embed", "base"} & set(page.seen)
    assert "http" not in text.replace('http-equiv="Content-Security-Policy"', "")
    assert "url(" not in text
    assert "@import" not in text
    for name, value in page.attributes:
        assert name not in ("srcset", "action", "onload", "onclick")
        assert name != "href" or (value or "").startswith("#")
        if name == "src":
            assert (value or "").startswith("data:image/png;base64,")
    # nothing runs: the one script element holds data
    assert page.seen.count("script") == 1
    assert ("type", "application/json") in page.attributes
    identifiers = [value for name, value in page.attributes if name == "id"]
    assert len(set(identifiers)) == len(identifiers)


def test_text_of_users_is_shown_and_never_read_as_html():
    evaluation = samples.evaluation(
        predicted=NASTY_NAME, mapping=NASTY_NAME, note=NASTY_NAME, part=NASTY_NAME
    )
    text = as_html(evaluation, pictures=[(NASTY_NAME, PNG)], title=NASTY_NAME)
    page = Page(text)
    assert "<b>.npy" not in text
    assert page.seen.count("script") == 1
    assert page.text.count(NASTY_NAME) >= 6
    assert json.loads(page.data)["files"]["predicted"] == [NASTY_NAME]


def test_pictures_that_are_not_png_are_refused():
    with pytest.raises(InputError, match="over: is no PNG picture"):
        as_html(samples.MATRIX, pictures=[("over", b"GIF89a")])
