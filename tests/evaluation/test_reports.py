from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest

from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.reports import as_csv, as_dict, as_json, as_markdown

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


def test_csv_has_one_row_a_class_and_one_overall() -> None:
    rows = list(csv.DictReader(io.StringIO(as_csv(MATRIX))))
    assert [row["class"] for row in rows] == ["ground", "building", "stem", "other", "unclassified", "(overall)"]
    assert (rows[0]["recall"], rows[0]["predicted building"]) == ("0.900000", "10")
    assert (rows[2]["recall"], rows[4]["predicted ground"]) == ("", "")
    assert (rows[-1]["n_reference"], rows[-1]["n_agreed"], rows[-1]["n_ignored"]) == ("202", "160", "5")
    assert float(rows[-1]["accuracy"]) == pytest.approx(160 / 202, abs=1e-6)
    assert None not in rows[-1]
    assert all(value is not None for row in rows for value in row.values())


def test_markdown_is_a_table_without_the_empty_classes() -> None:
    text = as_markdown(MATRIX)
    assert "90 (90.0%)" in text
    assert "stem" not in text
    assert "unclassified" not in text
    assert "| other " in text
    assert "Scored 202 records, ignored 5: accuracy 0.792, balanced accuracy 0.800, kappa " in text
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert len(tables) == 2
    for table in tables:
        assert len({line.count("|") for line in table}) == 1


def test_reports_of_an_empty_matrix() -> None:
    empty = ConfusionMatrix(("ground",), ("ground",), np.zeros((1, 1), np.int64))
    assert json.loads(as_json(empty))["overall"] == {"accuracy": None, "balanced_accuracy": None, "kappa": None}
    assert as_csv(empty).splitlines()[1].startswith("ground,0,0,0,,,,,")
    assert "accuracy -" in as_markdown(empty)
