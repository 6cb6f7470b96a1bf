from __future__ import annotations

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.html import as_html
from prc_cli.evaluation.reports import as_csv, as_dict, as_json, as_markdown, doubts
from prc_cli.evaluation.scores import Gate, check_gates, scores
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


def test_json_of_an_evaluation_adds_to_that_of_its_matrix() -> None:
    found = samples.evaluation()
    gates = check_gates(scores(found.matrix), [Gate("recall.ground", 0.99), Gate("recall.stem", 0.1)])
    table = json.loads(as_json(found, gates))
    plain = as_dict(found.matrix)
    assert {key: table[key] for key in plain} == plain
    assert table["files"] == {"predicted": ["labels.npy"], "reference": ["reference.csv.gz"]}
    assert table["match"] == {
        "method": "time", "n_predicted": 4000, "n_reference": 3500, "n_matched": 3212, "tolerance": 1e-6,
        "notes": ["Times were rounded."], "n_reference_matched": None,
    }  # fmt: skip
    assert set(table["intervals"]) == set(found.intervals)
    parts = table["splits"]["range"]
    assert [part["name"] for part in parts] == ["0-5 m", "5-10 m", "from 10 m", "unknown"]
    assert [(part["low"], part["high"]) for part in parts] == [(0, 5), (5, 10), (10, None), (None, None)]
    total = np.sum([part["confusion"]["counts"] for part in parts], axis=0)
    assert np.array_equal(total, found.matrix.counts)
    assert table["gates"][0] == {
        "name": "recall.ground", "limit": 0.99, "value": table["classes"]["ground"]["recall"], "passed": True
    }  # fmt: skip
    assert table["gates"][1] == {"name": "recall.stem", "limit": 0.1, "value": None, "passed": False}


def test_csv_of_an_evaluation_has_limits_and_parts() -> None:
    found = samples.evaluation()
    rows = list(csv.DictReader(io.StringIO(as_csv(found))))
    assert all(None not in row and None not in row.values() for row in rows)
    whole = [row for row in rows if not row["split"]]
    plain = list(csv.DictReader(io.StringIO(as_csv(found.matrix))))
    assert [{key: row[key] for key in plain[0]} for row in whole] == plain
    for name in ("recall", "precision", "f1", "iou", "accuracy"):
        interval = found.intervals[f"{name}.ground"]
        limits = float(whole[0][f"{name}_low"]), float(whole[0][f"{name}_high"])
        assert limits == pytest.approx((interval.low, interval.high), abs=1e-6)
    assert float(whole[-1]["kappa_high"]) == pytest.approx(found.intervals["kappa"].high, abs=1e-6)
    assert whole[2]["recall_low"] == ""  # no stems, no score, no interval
    near = [row for row in rows if (row["split"], row["part"]) == ("range", "0-5 m")]
    assert [row["predicted ground"] for row in near][:2] == ["61", "10"]
    assert {row["part"] for row in rows if row["split"] == "lines"} == {"0-98", "99-197"}


def test_markdown_of_an_evaluation() -> None:
    found = samples.evaluation()
    gates = check_gates(scores(found.matrix), [Gate("recall.ground", 0.99), Gate("recall.stem", 0.1)])
    text = as_markdown(found, gates)
    assert text.startswith("Reference in rows, predicted in columns: records (share of the row).")
    recall = found.matrix.counts[0, 0] / found.matrix.counts[0].sum()
    assert f"{recall:.3f} ({recall - 0.0311:.3f}-{min(recall + 0.0111, 1):.3f})" in text
    assert "Intervals: block jackknife, 31 blocks of 99 lines, 95 %." in text
    assert "By range:" in text
    assert "| from 10 m |" in text
    assert "Matched by time within 1e-06 s: 3,212 pairs of 4,000 predicted and 3,500 reference records." in text
    assert "Files: predicted labels.npy; reference reference.csv.gz. Class mapping: oakland." in text
    assert [line.split("|")[-2].strip() for line in text.splitlines() if "| recall." in line] == ["passed", "failed"]
    for table in (block.splitlines() for block in text.split("\n\n") if block.startswith("|")):
        assert len({line.count("|") for line in table}) == 1


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
