"""`prc evaluate PREDICTED... REFERENCE`: several methods in one table."""

import csv
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
    more = ("--intervals", "-M", "5")
    table = prc.json(*arguments(table_i), *more)["methods"]
    lines = list(csv.DictReader(written(prc, tmp_path / "a.csv", *arguments(table_i)).splitlines()))
    for zeta_p in TABLE_I:
        files = f"{table_i}/zeta_{zeta_p}.npy", f"{table_i}/car.npy"
        single = ("evaluate", *files, "--mapping", "lehtola_urban")
        assert table[f"PRC {zeta_p}"] == prc.json(*single, *more)
        rows = csv.DictReader(written(prc, tmp_path / f"{zeta_p}.csv", *single).splitlines())
        named = [{"method": f"PRC {zeta_p}", **row} for row in rows]
        assert [row for row in lines if row["method"] == f"PRC {zeta_p}"] == named != []
