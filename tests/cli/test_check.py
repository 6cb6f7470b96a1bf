"""``prc check`` and ``prc evaluate CLASSIFIED ANSWERS`` on the command line."""

import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes, Label
from tests.street import street, write_npz


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a drive and labels of it: ground near the scanner, else building."""
    folder = tmp_path_factory.mktemp("check")
    write_npz(folder / "drive.npz", street())
    with np.load(folder / "drive.npz") as drive:
        ranges = drive["range_m"]
    labels = np.where(ranges < 6, Label.GROUND, Label.BUILDING)
    labels[np.isnan(ranges)] = Label.MISSING
    np.save(folder / "labels.npy", ClassCodes().lookup()[labels].ravel())
    return folder


@pytest.fixture
def folder(files, tmp_path, monkeypatch):
    for path in files.iterdir():
        shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def answer(page: Path, target: Path, wrong: int = 0, person: str = "") -> None:
    """Answer as predicted, but for the first places."""
    text = page.read_text(encoding="utf-8")
    match = re.search(r'id="about">(.*?)</script>', text, re.DOTALL)
    assert match is not None
    table = json.loads(match[1])["answers"]
    for number, place in enumerate(table["places"]):
        predicted = table["strata"][place["stratum"]]["predicted"]
        others = [name for name in table["classes"] if name != predicted]
        place["answer"] = others[0] if number < wrong else predicted
    table["person"] = person
    target.write_text(json.dumps(table))


def test_drawn_answered_and_evaluated(prc, folder):
    drawn = prc("check drive.npz --labels labels.npy --shots 100")
    assert drawn.code == 0, drawn.err
    assert "prc evaluate labels.npy labels_answers.json" in drawn.err
    assert "building" in drawn.out
    answer(Path("labels_check.html"), Path("labels_answers.json"), wrong=5)
    result = prc("evaluate labels.npy labels_answers.json")
    assert result.code == 0, result.err
    assert "accuracy 0.9" in result.out
    assert "from 100 answers" in result.out

    table = prc.json("evaluate labels.npy labels_answers.json")
    assert table["n_answers"] == 100
    assert len(table["differences"]) == 5
    accuracy = table["scores"]["accuracy"]
    assert accuracy["low"] < accuracy["value"] < accuracy["high"]

    outputs = ("-o", "a.csv", "-o", "a.md", "-o", "a.json", "-o", "a.html")
    assert prc("evaluate labels.npy labels_answers.json -q", *outputs).code == 0
    rows = list(csv.DictReader(Path("a.csv").read_text(encoding="utf-8").splitlines()))
    assert float(rows[0]["value"]) == pytest.approx(accuracy["value"], abs=1e-6)


def test_missing_shots_of_a_table_have_no_coordinates(prc, folder):
    with np.load("drive.npz") as drive:
        ranges = drive["range_m"]
    rows = ["line,column,angle_deg,range_m,x,y,z"]
    for line, column in np.ndindex(ranges.shape):
        angle_deg = column * 360.0 / ranges.shape[1] - 180.0
        range_m = float(ranges[line, column])
        across_m, up_m = range_m * np.sin(np.radians((angle_deg, angle_deg + 90.0)))
        seen = f"{range_m:.3f},{0.1 * line:.3f},{across_m:.3f},{-up_m:.3f}"
        rows.append(f"{line},{column},{angle_deg:.3f}," + (seen if range_m > 0 else ",,,"))
    Path("drive.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    drawn = prc("check drive.csv c.html --labels labels.npy --shots 50")
    assert drawn.code == 0, drawn.err


def test_two_persons(prc, folder):
    assert prc("check drive.npz c.html --labels labels.npy --shots 50").code == 0
    answer(Path("c.html"), Path("ada.json"), person="Ada")
    answer(Path("c.html"), Path("ben.json"), wrong=5, person="Ben")
    result = prc("evaluate labels.npy ada.json ben.json")
    assert "Ada and Ben agree on 90.0% of 50 places" in result.out
    assert "from 50 answers" in result.out


def test_answers_to_other_shots_count_together(prc, folder):
    for seed in ("0", "1"):
        page = f"{seed}.html"
        options = ("--labels", "labels.npy", "--shots", "50", "--seed", seed)
        assert prc(f"check drive.npz {page}", *options).code == 0
        answer(Path(page), Path(f"{seed}.json"))
    result = prc("evaluate labels.npy 0.json 1.json --json")
    assert 90 < json.loads(result.out)["n_answers"] <= 100


def test_what_is_refused(prc, folder):
    assert prc("check drive.npz c.html --labels labels.npy --shots 50").code == 0
    answer(Path("c.html"), Path("a.json"))
    evaluate = ("evaluate", "labels.npy", "a.json")
    gate = prc(*evaluate, "--fail-under", "recall.tree=0.5")
    assert gate.code == 2
    assert "expected one of: accuracy, recall.ground" in gate.err
    assert prc(*evaluate, "--fail-under", "accuracy=0.9", "-q").code == 0
    assert prc(*evaluate, "--match", "nearest").code == 2
    assert prc(*evaluate, "-o", "a.pdf").code == 2
    np.save("labels.npy", np.zeros(5, np.uint8))
    other = prc(*evaluate)
    assert other.code == 1
    assert "a file labels.npy with other content" in other.err
    existing = prc("check drive.npz c.html --labels labels.npy")
    assert existing.code == 2
