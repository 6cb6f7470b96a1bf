from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.html import as_html
from prc_cli.evaluation.reports import as_dict, as_json, as_markdown, doubts
from tests.evaluation import samples

MATRIX = ConfusionMatrix(
    ("ground", "building", "stem", "other"),
    ("ground", "building", "stem", "unclassified"),
    np.array([[90, 10, 0, 0], [30, 70, 0, 0], [0, 0, 0, 0], [2, 0, 0, 0]]),
    n_ignored=5,
)


def test_json_holds_the_dictionary_and_null_for_undefined() -> None:
    table = json.loads(as_json(MATRIX))
    assert table == as_dict(MATRIX)
    assert table["classes"]["ground"]["recall"] == 0.9
    assert table["classes"]["stem"]["recall"] is None
    assert table["classes"]["other"]["n_reference"] == 2
    assert table["overall"]["accuracy"] == pytest.approx(160 / 202)
    assert table["confusion"]["counts"] == MATRIX.counts.tolist()
    assert (table["n_scored"], table["n_ignored"]) == (202, 5)


def test_markdown_shows_names_of_users_as_they_are() -> None:
    found = samples.evaluation(predicted="a|b_*c*\n# d.npy", part="a|b <b>")
    text = as_markdown(found)
    assert "a\\|b\\_\\*c\\* \\# d.npy" in text
    assert "a\\|b \\<b\\>" in text
    for table in (block.splitlines() for block in text.split("\n\n") if block.startswith("|")):
        assert len({line.replace("\\|", "").count("|") for line in table}) == 1


def test_agreement_of_chance_is_told() -> None:
    found = samples.evaluation()
    assert doubts(found) == ()
    rng = np.random.default_rng(4)
    codes = rng.choice(2, 5000, p=[0.9, 0.1])
    counts = np.bincount(codes * 2 + rng.permutation(codes), minlength=4).reshape(2, 2)
    shuffled = replace(found, matrix=ConfusionMatrix(("a", "b"), ("a", "b"), counts), splits={}, intervals={})
    (told,) = doubts(shuffled)
    assert "about that of chance" in told
    assert told in as_html(shuffled)
    assert told in as_markdown(shuffled)
    assert json.loads(as_json(shuffled))["doubts"] == [told]
    # a file with one class has no kappa, and few records prove nothing
    for other in ([[5000, 0], [0, 0]], [[5, 5], [5, 5]]):
        matrix = ConfusionMatrix(("a", "b"), ("a", "b"), np.array(other))
        assert doubts(replace(shuffled, matrix=matrix)) == ()
