"""``prc evaluate`` on the command line: files of every format, folders, gates, errors."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from prc_cli.cli import main


class Prc:
    """Runs ``prc evaluate`` in this process; gives exit code, stdout and stderr."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object) -> tuple[int, str, str]:
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main(["evaluate", *(str(argument) for argument in arguments)])
        captured = self._capsys.readouterr()
        return int(stop.value.code or 0), captured.out, captured.err


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


def save(folder: Path, name: str, predicted: list[int], reference: list[int]) -> tuple[Path, Path]:
    """A predicted and a reference file of one name in two folders."""
    paths = folder / "run" / f"{name}.npy", folder / "reference" / f"{name}.csv"
    for path in paths:
        path.parent.mkdir(exist_ok=True)
    np.save(paths[0], np.array(predicted, np.uint8))
    with paths[1].open("w", encoding="utf-8") as handle:
        csv.writer(handle).writerows([["class"], *([code] for code in reference)])
    return paths


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    return save(tmp_path, "a", [2, 2, 6, 6, 5, 0], [2, 2, 6, 5, 5, 0])


@pytest.mark.parametrize(
    ("suffix", "sign"),
    [
        (".json", '"n_scored": 5'),
        (".csv", "class,n_reference"),
        (".md", "| reference  |"),
        (".tex", r"\toprule"),
        (".html", "<!DOCTYPE html>"),
    ],
)
def test_output_in_every_form_leaves_stdout_as_it_was(
    prc: Prc, pair: tuple[Path, Path], tmp_path: Path, suffix: str, sign: str
) -> None:
    target = tmp_path / f"report{suffix}"
    plain = prc(*pair)
    assert prc(*pair, "--output", target) == plain
    assert sign in target.read_text(encoding="utf-8")
    code, out, err = prc(*pair, "--output", target)
    assert (code, out) == (2, "")
    assert "report" in err
    assert "exists already; choose another name or add --overwrite" in err
    assert prc(*pair, "--output", target, "--overwrite", "-q")[:2] == (0, "")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["reference", f"report{suffix}", "run"]


def test_several_outputs_and_stdout_say_the_same(prc: Prc, pair: tuple[Path, Path], tmp_path: Path) -> None:
    names = [tmp_path / f"report{suffix}" for suffix in (".json", ".csv", ".md", ".tex", ".html")]
    outputs = [word for name in names for word in ("--output", name)]
    assert prc(*pair, *outputs, "--quiet") == (0, "", "")
    for name, form in zip(names, ("json", "csv", "markdown", "latex", "html"), strict=True):
        assert prc(*pair, "--format", form)[1] == name.read_text(encoding="utf-8")


def test_failed_gates_are_written_and_end_with_3(prc: Prc, pair: tuple[Path, Path], tmp_path: Path) -> None:
    page, table = tmp_path / "report.html", tmp_path / "report.json"
    gates = ["--fail-under", "recall.ground=1", "--fail-under", "recall.vegetation=0.9", "--fail-under", "kappa=0.99"]
    code, out, err = prc(*pair, *gates, "--output", page, "--output", table)
    assert code == 3
    assert "recall.vegetation: found 0.5000, demanded at least 0.9000; kappa: found" in err
    assert "recall.ground: found 1.0000, demanded 1: passed" in out
    assert [gate["passed"] for gate in json.loads(table.read_text())["gates"]] == [True, False, False]
    assert "2 of 3 gates failed" in page.read_text(encoding="utf-8")


def test_folders_and_pairs_are_pooled(prc: Prc, tmp_path: Path) -> None:
    first = save(tmp_path, "a", [2, 2, 6], [2, 2, 5])
    second = save(tmp_path, "b", [5, 5], [5, 6])
    single = [json.loads(prc(*files, "--json")[1]) for files in (first, second)]
    pooled = json.loads(prc(tmp_path / "run", tmp_path / "reference", "--json")[1])
    counts = [np.array(table["confusion"]["counts"]) for table in (*single, pooled)]
    assert np.array_equal(counts[0] + counts[1], counts[2])
    assert pooled["files"]["predicted"] == [str(first[0]), str(second[0])]
    by_pair = json.loads(prc(*first, "--pair", *second, "--json")[1])
    assert by_pair == pooled


def test_match_is_told(prc: Prc, pair: tuple[Path, Path]) -> None:
    assert "Matched by order: 6 pairs of 6 predicted and 6 reference records." in prc(*pair)[1]
    assert json.loads(prc(*pair, "--json")[1])["match"]["method"] == "order"


def test_pictures_are_put_into_the_page(prc: Prc, pair: tuple[Path, Path], tmp_path: Path) -> None:
    picture = tmp_path / "a=b.png"
    Image.new("RGB", (4, 3), "red").save(picture)
    page = tmp_path / "report.html"
    assert prc(*pair, "-q", "-o", page, "--picture", picture, "--picture", f"Classes & more={picture}")[0] == 0
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/png;base64,") == 2
    assert "<figcaption>a=b</figcaption>" in text
    assert "<figcaption>Classes &amp; more</figcaption>" in text


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--output", "report.pdf"], 2, "report.pdf: found the suffix '.pdf', expected one of: .json .csv .md .tex"),
        (["--output", "none/report.md"], 1, "none: output folder does not exist"),
        (["--output", "r.md", "--output", "r.md"], 2, "--output: found one file twice"),
        (["--output", "reference/a.csv", "--overwrite"], 2, "reference/a.csv: the output is the input itself"),
        (["--by-range", "5,3"], 2, "--by-range: found '5,3', expected ranges in metres that rise, such as 5,10,20,40"),
        (["--by-range", "5,,8"], 2, "--by-range: found '5,,8'"),
        (["--by-range", "-5,8"], 2, "--by-range: found '-5,8'"),
        (["--by-range", "5,nan"], 2, "--by-range: found '5,nan'"),
        (["--by-lines", "0"], 2, "--by-lines"),
        (["--min-matched", "1.5"], 2, "--min-matched"),
        (["--picture", "x.png"], 2, "--picture: pictures have their place in the HTML page alone"),
        (["--picture", "none.png", "--output", "r.html"], 1, "none.png: cannot be read"),
        (["--picture", "reference/a.csv", "--output", "r.html"], 1, "reference/a.csv: is no PNG picture"),
        (["--fail-under", "recall.road=1", "--output", "r.html"], 2, "score: found class 'road'"),
        (
            ["--fail-under", "recall.noise=1", "--mapping", "oakland"],
            2,
            "which the mapping does not have on both sides",
        ),
        (["--intervals"], 1, "make the blocks shorter with --interval-lines, or give -M"),
        (["--match", "magic"], 2, "magic"),
        (["--pair", "none.npy", "reference/a.csv"], 1, "none.npy: no such file"),
        (["--pair", "run", "reference/a.csv"], 1, "a file against the folder run"),
    ],
)
def test_refusals_are_one_line_and_leave_nothing(
    prc: Prc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], code: int, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    save(tmp_path, "a", [2, 6], [2, 6])
    found = prc("run/a.npy", "reference/a.csv", *arguments)
    assert found[0] == code
    assert found[1] == ""
    assert message in found[2]
    assert found[2].count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["reference", "run"]


@pytest.mark.data
def test_three_strips_of_a_street_as_one_page(prc: Prc, real_data: Path, tmp_path: Path) -> None:
    from prc_cli.jobs.evaluate import evaluate

    # the reference against itself, in the codes of this program
    names = [real_data / "oakland" / f"oakland_{strip}.csv.gz" for strip in (1, 2, 3)]
    mapping = tmp_path / "self.toml"
    mapping.write_text(
        'unlisted = "other"\nignore = [0]\n[predicted]\nground = ["1200-1206"]\nleaf = [1300]\n'
        '[reference]\nground = ["1200-1206"]\nleaf = [1300]\n'
    )
    page, table = tmp_path / "all.html", tmp_path / "all.json"
    pairs = [word for name in names[1:] for word in ("--pair", name, name)]
    assert prc(names[0], names[0], *pairs, "--mapping", mapping, "-q", "-o", page, "-o", table) == (0, "", "")
    found = json.loads(table.read_text())
    assert found["overall"]["accuracy"] < 1.0  # "other" never agrees
    assert found["classes"]["leaf"]["recall"] == 1.0
    parts = [evaluate(name, name, mapping).n_scored for name in names]
    assert found["n_scored"] == sum(parts)
    assert "unlisted" not in page.read_text(encoding="utf-8")


def test_page_of_a_dense_stream_has_pictures_of_its_own(prc: Prc, pair: tuple[Path, Path], tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert prc(*pair, "-q", "-o", page, "-M", 3)[0] == 0
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/png;base64,") == 3
    assert "Predicted, lines 0-1 of a.npy" in text


def test_undefined_figures_are_told_in_words(prc: Prc, tmp_path: Path) -> None:
    pair = save(tmp_path, "a", [2, 2, 6], [2, 2, 2])
    code, out, err = prc(*pair, "--fail-under", "recall.building=0.5")
    assert code == 3
    assert "recall.building: found undefined (no such records), demanded at least 0.5" in err
    assert "(-)" in out
    assert "nan" not in out + err


def record(path: Path, method: str, **tables: object) -> None:
    """Put the run record of a method beside a predicted file."""
    made = {"program": "prc-cli", "config": {"method": method, **tables}}
    path.with_name(f"{path.name}.prc.json").write_text(json.dumps(made))


@pytest.mark.parametrize(
    ("method", "tables", "mapping"),
    [
        ("fused", {"fused": {"environment": "urban"}}, "street"),
        ("fused", {"fused": {"environment": "forest"}}, "prc"),
        ("sequential-angle", {}, "street_scan"),
        ("prc", {}, "prc"),
        ("fused", {"fused": 3}, "prc"),
        (["fused"], {}, "prc"),
    ],
)
def test_the_run_record_beside_the_predicted_file_names_the_mapping(
    prc: Prc, tmp_path: Path, method: str, tables: dict[str, object], mapping: str
) -> None:
    paths = save(tmp_path, "a", [2, 2, 65, 66, 5, 0], [2, 2, 65, 5, 5, 0])
    record(paths[0], method, **tables)
    code, out, err = prc(*paths, "--json")
    assert (code, json.loads(out)["mapping"]) == (0, mapping)
    said = f"mapping: {mapping} (the run record says {method}); --mapping names another\n"
    assert err == ("" if mapping == "prc" else said)
    code, out, err = prc(*paths, "--json", "--mapping", "prc")
    assert (code, json.loads(out)["mapping"], err) == (0, "prc", "")
    assert prc(*paths, "-q") == (0, "", "")


def test_labels_of_semantic_kitti_have_the_mapping_of_the_method(prc: Prc, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([2, 5, 65], np.uint8))
    np.array([40, 70, 10], "<u4").tofile(tmp_path / "a.label")
    for method, mapping in (
        (None, "semantic_kitti"),
        ("fused", "street_kitti"),
        ("sequential-angle", "street_scan_kitti"),
    ):
        if method:
            record(tmp_path / "a.npy", method, fused={"environment": "urban"})
        code, out, err = prc(tmp_path / "a.npy", tmp_path / "a.label", "--json")
        assert (code, json.loads(out)["mapping"]) == (0, mapping)
        assert "the reference holds labels of SemanticKITTI" in err


def test_files_of_different_methods_are_compared_in_the_classes_of_prc(prc: Prc, tmp_path: Path) -> None:
    for name in ("a", "b"):
        save(tmp_path, name, [2, 2, 65, 66], [2, 2, 65, 5])
        record(tmp_path / "run" / f"{name}.npy", "fused", fused={"environment": "urban"})
    found = prc(tmp_path / "run", tmp_path / "reference", "--json")
    assert json.loads(found[1])["mapping"] == "street"
    record(tmp_path / "run" / "b.npy", "prc")
    found = prc(tmp_path / "run", tmp_path / "reference", "--json")
    assert (json.loads(found[1])["mapping"], found[2]) == ("prc", "")
    (tmp_path / "run" / "b.npy.prc.json").write_text("[" * 100_000)
    assert json.loads(prc(tmp_path / "run", tmp_path / "reference", "--json")[1])["mapping"] == "prc"
