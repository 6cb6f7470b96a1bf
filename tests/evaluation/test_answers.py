"""Answers files: damaged ones, several persons, several samples."""

import json
from pathlib import Path
from typing import Any

import pytest

from prc_cli.core.errors import InputError
from prc_cli.evaluation.answers import CANNOT_TELL, KIND, Answers, load_answers, pool
from prc_cli.evaluation.sampled import agreement_line, as_csv, as_dict, as_markdown, evaluate_sample
from prc_cli.evaluation.sampled_html import answer_matrix, sampled_html

PATH = Path("x.json")


def table(answers: list[str | None], *, person: str = "", first_line: int = 0) -> dict[str, Any]:
    """Answers to shots of two strata in turn; ground first."""
    return {
        "kind": KIND,
        "format": 1,
        "version": "2.0",
        "classified": {"name": "out.laz", "size": 1, "sha256": "ab"},
        "classes": ["ground", "car"],
        "seed": 0,
        "strata": [
            {"predicted": "ground", "n_shots": 900, "n_drawn": 3},
            {"predicted": "car", "n_shots": 100, "n_drawn": 3},
        ],
        "person": person,
        "places": [
            {
                "scanner": 0,
                "line": first_line + k,
                "column": 5,
                "record": k,
                "stratum": k % 2,
                "answer": answer,
                "time": None,
            }
            for k, answer in enumerate(answers)
        ],
    }


def answers_of(*answers: str | None, person: str = "", first_line: int = 0) -> Answers:
    return Answers.model_validate(table(list(answers), person=person, first_line=first_line))


def test_answers_are_counted_by_stratum():
    pooled = pool(
        [PATH], [answers_of("ground", "car", "car", CANNOT_TELL, None, "other", "ground")]
    )
    assert pooled.sample.counts.tolist() == [[2, 1, 0], [0, 1, 1]]
    assert pooled.sample.n_unsure.tolist() == [0, 1]
    assert (pooled.n_places, pooled.n_open, pooled.n_other) == (7, 1, 1)
    assert [
        (difference.line, difference.predicted, difference.answer)
        for difference in pooled.differences
    ] == [
        (2, "ground", "car"),
        (5, "car", "other"),
    ]
    notes = " ".join(evaluate_sample("out.laz", ("x.json",), pooled).notes)
    assert "1 of 7 places are not answered yet" in notes
    assert '1 answers are "cannot tell"' in notes
    assert "1 answers are other" in notes


def test_two_persons_give_kappa_and_count_once():
    first = answers_of("ground", "car", "ground", "car", person="Ada")
    second = answers_of("ground", "car", "car", "car", person="Ben")
    pooled = pool([PATH, PATH], [first, second])
    assert pooled.sample.counts.sum() == 4
    evaluation = evaluate_sample("out.laz", ("a.json", "b.json"), pooled)
    # agree on 3 of 4; by chance 1/2 * 1/4 + 1/2 * 3/4 = 1/2
    assert evaluation.kappa == pytest.approx(0.5)
    assert agreement_line(evaluation) == "Ada and Ben agree on 75.0% of 4 places, kappa 0.500."
    assert "kappa 0.500" in as_markdown(evaluation)
    assert as_dict(evaluation)["kappa"] == pytest.approx(0.5)
    accuracy = evaluation.scores["accuracy"].value
    assert f",accuracy,{accuracy:.6f}," in as_csv(evaluation)


def test_the_page_has_the_counts_and_escapes_names():
    first = answers_of("ground", "car", "car", CANNOT_TELL, "other", "car", person="<i>Ada")
    second = answers_of("ground", "car", "ground", "car", person="Ben")
    pooled = pool([PATH, PATH], [first, second])
    matrix = answer_matrix(pooled.sample)
    assert matrix.reference_names == ("ground", "car", "other")
    assert matrix.predicted_names == ("ground", "car")
    assert matrix.counts.tolist() == [[1, 0], [1, 2], [1, 0]]
    evaluation = evaluate_sample("<b>out.laz", ("a.json", "b.json"), pooled)
    page = sampled_html(evaluation)
    shown = page.partition("<script")[0]
    for name in evaluation.classes:
        recall = evaluation.scores[f"recall.{name}"]
        assert f"<td>{recall.value:.3f}" in shown
        assert f"{recall.low:.3f} – {recall.high:.3f}</small>" in shown
    assert "33.3%<small>1</small>" in shown
    unsure = "".join(f'<td class="sum">{count}</td>' for count in (0, 1, 1))
    assert f"<th>cannot tell</th>{unsure}" in shown
    assert f"<b>{evaluation.kappa:.3f}</b><span>Cohen" in shown
    assert "&lt;b&gt;out.laz" in shown
    assert "&lt;i&gt;Ada and Ben agree" in shown
    assert "<b>out" not in page
    assert "<i>" not in page
    data = page.partition('id="evaluation">')[2].partition("</script>")[0]
    assert json.loads(data) == as_dict(evaluation)


def test_answers_about_another_file_are_not_pooled():
    another = table(["ground"])
    another["classified"]["sha256"] = "cd"
    with pytest.raises(InputError, match="about another file"):
        pool([PATH, PATH], [answers_of("ground"), Answers.model_validate(another)])


def test_nothing_answered_is_refused():
    with pytest.raises(InputError, match="no place has an answer"):
        evaluate_sample("out.laz", ("x.json",), pool([PATH], [answers_of(None, None)]))


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("[1]", "contains no answers"),
        ('{"kind": "other"}', "contains no answers"),
        (json.dumps({**table(["ground"]), "format": 2}), "format"),
        (json.dumps({**table(["ground"]), "strata": []}), "no stratum 0"),
        (json.dumps(table(["tree"])), "'tree', which is no class"),
        (json.dumps({**table(["ground"]), "extra": 1}), "extra"),
        (json.dumps(table(["ground"])).replace("900", "0"), "n_shots"),
    ],
)
def test_damaged_files_are_refused(text, message, tmp_path):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_answers(path)
