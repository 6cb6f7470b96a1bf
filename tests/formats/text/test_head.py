"""Lines before the rows, as NumPy, CloudCompare, MATLAB, Excel and R write them."""

from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.text.read import TextSource

ROWS = [(i // 5, i % 5, -10.5 + i, 20.25 + i) for i in range(30)]
NAMES = ("scan_line", "column", "angle", "range")


def write(
    path: Path,
    head: str,
    delimiter: str = " ",
    *,
    has_row_names: bool = False,
) -> Path:
    lines = [delimiter.join(map(str, row)) for row in ROWS]
    if has_row_names:
        lines = [f'"{i + 1}"{delimiter}{line}' for i, line in enumerate(lines)]
    path.write_text(head + "\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("suffix", [".txt", ".csv", ".asc"])
@pytest.mark.parametrize(
    "head, delimiter, line",
    [
        ("# scan_line column angle range\n", " ", 1),
        ("#scan_line,column,angle,range\n", ",", 1),
        ("# run 7 of today\n# scan_line column angle range\n", " ", 2),
        ("//Scan_Line Column Angle Range\n30\n", " ", 1),
        ("// scan_line column angle range\n", " ", 1),
        ("//scan_line,column,angle,range\n", ",", 1),
        ("% scan_line column angle range\n", " ", 1),
        ("sep=;\nscan_line;column;angle;range\n", ";", 2),
        ("Export of run 7\nscan_line,column,angle,range\n", ",", 2),
        ("Project: street, east\nDate: today\n\nscan_line,column,angle,range\n", ",", 4),
        ("scan_line,column,angle,range\n-,-,deg,m\n", ",", 1),
        ("scan_line;column;angle;range\n[-];[-];[°];[m]\n", ";", 1),
        ("scan_line column angle range\n", " ", 1),
    ],
)
def test_names_are_found(
    tmp_path,
    head,
    delimiter,
    line,
    suffix,
):
    source = TextSource(write(tmp_path / f"a{suffix}", head, delimiter))
    assert source.text.header_line == line
    values = next(iter(source.chunks(NAMES))).values
    np.testing.assert_allclose(values["range"], [row[3] for row in ROWS])
    np.testing.assert_allclose(np.rad2deg(values["angle"]), [row[2] for row in ROWS])


@pytest.mark.parametrize("suffix", [".xyz", ".asc", ".pts", ".txt"])
def test_a_count_of_rows_is_no_row(tmp_path, suffix):
    source = TextSource(write(tmp_path / f"a{suffix}", "30\n"))
    assert sum(chunk.n for chunk in source.chunks(source.dimensions)) == 30


@pytest.mark.parametrize(
    "cell, hint",
    [
        ('"68,072.0"', "without thousands separators"),
        ("1.5D+02", "exponents with E"),
        ("\u22125.0", "write the minus as -"),
        ("2024-05-01T10:00:00", "times as seconds"),
        ("range", "sed 9d IN > OUT"),
        ('"68,07"', "write decimals with a point"),
        ("\x1a", "tr -d"),
        ("wall", "write nan"),
    ],
)
def test_a_cell_that_is_no_number_gets_its_own_hint(tmp_path, cell, hint):
    rows = [f"{i},{i}.5" for i in range(60)]
    rows[7] = f"7,{cell}"
    (tmp_path / "a.csv").write_text("scan_line,range\n" + "\n".join(rows) + "\n")
    with pytest.raises(InputError) as caught:
        list(TextSource(tmp_path / "a.csv").chunks(("range",)))
    assert hint in caught.value.hint


@pytest.mark.parametrize("word", ["NA", "N/A", "NULL", "None", "#N/A", "nan", ""])
def test_words_for_nothing_are_missing(tmp_path, word):
    rows = [f"{i},{word if i % 3 == 0 else i}" for i in range(60)]
    (tmp_path / "a.csv").write_text("scan_line,range\n" + "\n".join(rows) + "\n")
    (chunk,) = TextSource(tmp_path / "a.csv").chunks(("range",))
    assert np.isnan(chunk.values["range"]).sum() == 20
