"""`prc evaluate PREDICTED... REFERENCE`: several methods in one table."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import Prc
from tests.evaluation.test_paper_tables import TABLE_I

CODES = (7, 2, 5, 6)
OTHER = 65


@pytest.fixture(scope="module")
def table_i(tmp_path_factory):
    """Write both methods of Table I of Lehtola et al. (2019), and their reference."""
    folder = tmp_path_factory.mktemp("table_i")
    np.save(folder / "car.npy", np.repeat((*CODES, OTHER), 1000).astype(np.uint8))
    for zeta_p, rows in TABLE_I.items():
        codes = []
        for row in rows:
            bounds = np.rint(1000 * np.cumsum(row) / sum(row)).astype(int)
            codes.append(np.repeat(CODES, np.diff(bounds, prepend=0)))
        np.save(folder / f"zeta_{zeta_p}.npy", np.concatenate(codes).astype(np.uint8))
    return folder


def arguments(folder: Path) -> list[str]:
    names = [f"PRC {zeta_p}={folder / f'zeta_{zeta_p}.npy'}" for zeta_p in TABLE_I]
    return ["evaluate", *names, str(folder / "car.npy"), "--mapping", "lehtola_urban"]


def written(prc: Prc, path: Path, *command: str) -> str:
    """Return the file that a comparison writes."""
    prc(*command, "-q", "-o", path)
    return path.read_text()


def test_table_i_has_a_column_for_each_method(prc, table_i):
    done = prc(*arguments(table_i))
    assert done.code == 0
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in done.out.splitlines()]
    recalls = [row[1:] for row in rows if row and row[0] == "recall"]
    assert [name for name, *_ in recalls] == ["noise", "ground", "vegetation", "building"]
    for k, (_, *cells) in enumerate(recalls):
        # the printed shares of a row add up to .999 or 1.001
        printed = [TABLE_I[zeta_p][k][k] for zeta_p in TABLE_I]
        assert [float(cell) for cell in cells] == pytest.approx(printed, abs=0.0011)


def test_the_confusion_of_the_paper_is_written(prc, table_i, tmp_path):
    text = written(prc, tmp_path / "a.md", *arguments(table_i))
    lines = [" ".join(line.split()) for line in text.splitlines()]
    for shares in TABLE_I.values():
        for row in shares:
            cells = [f"{share / sum(row):.3f}" for share in row]
            assert any(line.endswith(f"{' | '.join(cells)} |") for line in lines)


def test_every_cell_is_that_of_a_single_run(prc, table_i, tmp_path):
    table = json.loads(prc(*arguments(table_i), "--json", "--intervals", "-M", "5").out)
    lines = list(csv.DictReader(written(prc, tmp_path / "a.csv", *arguments(table_i)).splitlines()))
    for zeta_p in TABLE_I:
        labels = str(table_i / f"zeta_{zeta_p}.npy")
        single = ("evaluate", labels, str(table_i / "car.npy"), "--mapping", "lehtola_urban")
        alone = json.loads(prc(*single, "--json", "--intervals", "-M", "5").out)
        assert table["methods"][f"PRC {zeta_p}"] == alone
        assert alone["intervals"]
        rows = [dict(row) for row in lines if row["method"] == f"PRC {zeta_p}"]
        for row in rows:
            del row["method"]
        assert rows == list(
            csv.DictReader(written(prc, tmp_path / f"{zeta_p}.csv", *single).splitlines())
        )


def test_page_has_every_method(prc, table_i, tmp_path):
    page = tmp_path / "page.html"
    assert prc(*arguments(table_i), "--output", str(page), "-q").code == 0
    text = page.read_text(encoding="utf-8")
    assert text.count("<h2>PRC ") == 2
    assert "<b>0.964</b>" in text
    assert 'src="http' not in text


def test_names_come_from_records_names_and_files(prc, table_i, tmp_path):
    labels = np.load(table_i / "zeta_0.1.npy")
    for name in ("monday", "tuesday", "by_hand"):
        np.save(tmp_path / f"{name}.npy", labels)
    record = {"program": "prc-cli", "config": {"method": "prc"}, "assumptions": []}
    for name in ("monday", "tuesday"):
        (tmp_path / f"{name}.npy.prc.json").write_text(json.dumps(record), encoding="utf-8")
    files = [str(tmp_path / f"{name}.npy") for name in ("monday", "tuesday", "by_hand")]
    ends = [str(table_i / "car.npy"), "--mapping", "lehtola_urban", "--json"]
    names = list(json.loads(prc("evaluate", *files, *ends).out)["methods"])
    assert names == ["prc (monday)", "prc (tuesday)", "by_hand"]
    twice = prc(f"evaluate a={files[0]} a={files[1]}", *ends)
    assert twice.code == 2
    assert f"NAME={files[1]}" in twice.err


@pytest.mark.parametrize("option", [("--third", "car.npy"), ("--by", "range:5,10")])
def test_options_for_one_prediction_are_refused(prc, table_i, option):
    name, value = option
    value = str(table_i / value) if name == "--third" else value
    done = prc(*arguments(table_i), name, value)
    assert done.code == 2
    assert "expected one" in done.err


def test_gates_hold_for_every_method(prc, table_i):
    done = prc(*arguments(table_i), "--fail-under", "recall.ground=0.9")
    assert done.code == 3
    assert "PRC 0.1: recall.ground" in done.err
    assert "PRC 1.0" not in done.err


def test_one_file_is_refused(prc, table_i):
    done = prc(f"evaluate {table_i}/car.npy")
    assert done.code == 2
    assert "REFERENCE" in done.err
