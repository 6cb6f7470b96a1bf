"""Text files: detection of the dialect, values independent of blocks, and line numbers of
errors."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.errors import InputError
from prc_cli.formats.input import Input
from prc_cli.formats.options import Layout
from prc_cli.formats.records import Source
from prc_cli.formats.text import lines as text_lines
from prc_cli.formats.text.dialect import find_format
from prc_cli.formats.text.read import TextSource


def write(folder: Path, content: str | bytes, name: str = "drive.csv") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def read(source: Source, *names: str) -> dict[str, np.ndarray[Any, Any]]:
    """All records; a typed parameter, so that mypy holds TextSource to the protocol."""
    chunks = list(source.chunks(names))
    assert [chunk.first_record for chunk in chunks] == list(
        np.cumsum([0] + [c.n for c in chunks])[: len(chunks)]
    )
    assert all(
        chunk.n and chunk.record is None and set(chunk.values) == set(names) for chunk in chunks
    )
    empty: list[np.ndarray[Any, Any]] = [np.empty(0)]
    return {
        name: np.concatenate([chunk.values[name] for chunk in chunks] or empty) for name in names
    }


def problem(
    folder: Path,
    content: str | bytes,
    layout: Layout | None = None,
    name: str = "range",
) -> str:
    """The error of reading a column, without the folder; always one line."""
    with pytest.raises(InputError) as caught:
        read(TextSource(write(folder, content), layout), name)
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{folder}/", "")


CELLS = st.sampled_from(["", "nan", "1", "-2.5", "1e3", " 7 ", "+4", "inf", '"8"', "  "])


@given(
    rows=st.lists(st.tuples(CELLS, CELLS), min_size=1, max_size=12),
    between=st.lists(
        st.sampled_from(["", "\n", "# c,d\n", "\r\n", "  \n"]), min_size=12, max_size=12
    ),
    block=st.integers(1, 60),
    delimiter=st.sampled_from([",", ";"]),
)
def test_values_do_not_depend_on_blocks(
    tmp_path_factory,
    rows,
    between,
    block,
    delimiter,
):
    lines = [f"{a}{delimiter}{b}\n{gap}" for (a, b), gap in zip(rows, between, strict=False)]
    path = write(tmp_path_factory.mktemp("text"), f"u{delimiter}v\n" + "".join(lines))
    expected = [[float(cell.strip(' "') or "nan") for cell in row] for row in rows]
    columns = read(TextSource(path, block_bytes=block), "u", "v")
    np.testing.assert_array_equal(np.stack([columns["u"], columns["v"]], axis=1), expected)


@pytest.mark.parametrize(
    "content, message",
    [
        (
            "range,x\n1,2\n\n# c\nabc,3\n",
            "line 5: column 'range': found 'abc', expected a number; leave the",
        ),
        (
            "range;x\n1.5;2\n3,5;3\n",
            "line 3: column 'range': found '3,5', expected a number; write decimals with",
        ),
        ("range,x\n1,2\n0x10,3\n", "line 3: column 'range': found '0x10', expected a number"),
        ("range,x\n1,2\n1_0,3\n", "line 3: column 'range': found '1_0', expected a number"),
        (
            b"range,x\n1,2\n\xe41,3\n",
            "line 3: column 'range': found bytes that are not UTF-8, expected a number",
        ),
        ("range,x\n1,2\n3\n", "line 3: 1 cells, expected 2 as in line 1: '3'"),
        ("range,x\r\n1,2\r\n3,4,5\r\n", "line 3: 3 cells, expected 2 as in line 1: '3,4,5'"),
        ("# c\n\nrange x\n1 2\n3 4 5\n", "line 5: 3 cells, expected 2 as in line 3: '3 4 5'"),
        ('range,x\n1,2\n3,"4\n5,6\n', "line 3: found '3,\"4', expected cells with closed quotes"),
        ('range,x\n1,"a\n2,b"\n', "line 2: found '1,\"a', expected cells with closed quotes"),
        (
            "range,x\n1,2\r3,4\n",
            "line 2: a carriage return inside the line, expected lines that end in LF or CR LF",
        ),
        ("range,x\r1,2\r3,4", "line 1: a carriage return inside the line"),
        ("range\n1\n\n2\n", "line 3: a blank line between rows of one column"),
        ("range\n1\n# c\n  \n2\n", "line 4: a blank line between rows of one column"),
        (
            "range,range,x\n1,2,3\n",
            "line 1: the name 'range' is in columns 0 and 1, expected once",
        ),
    ],
)
@pytest.mark.parametrize("block", [5, 1 << 22])
def test_errors_name_the_line_and_the_text(
    tmp_path,
    content,
    message,
    block,
):
    path = write(tmp_path, content)
    with pytest.raises(InputError) as caught:
        read(TextSource(path, block_bytes=block), "range")
    assert str(caught.value).startswith(f"{path}: {message}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content, message",
    [
        (b"", "the file is empty, expected a record a row"),
        (b"\xef\xbb\xbf", "the file is empty"),
        (b"\n# c\n\n", "only comments and blank lines, expected a record a row"),
        (b"line,range\n", "no row follows the header in line 1"),
        (b"# c\nline,range", "no row follows the header in line 2"),
        (b"r\xe4nge,x\n1,2\n", "line 1: byte 2 of the line (0xe4) is not UTF-8, expected"),
        ("range\n1\n".encode("utf-16"), "the text is UTF-16, expected UTF-8; convert it: iconv"),
        ("range\n1\n".encode("utf-16-le"), "byte 1 is 0, expected a text file in UTF-8"),
        (
            gzip.compress(b"range\n1\n", mtime=0),
            "the content is gzip-compressed, expected text; rename it to drive.csv.gz",
        ),
        (b",".join([b"1"] * 10_001) + b"\n", "line 1: 10001 cells, expected at most 10000"),
    ],
)
def test_files_that_hold_no_rows_or_no_text(tmp_path, content, message):
    assert message.removesuffix(", expected") in problem(tmp_path, content)


def test_a_line_without_end_is_refused_before_it_is_held(tmp_path, monkeypatch):
    monkeypatch.setattr(text_lines, "MAX_LINE_BYTES", 1000)
    path = write(tmp_path, b"range\n1\n" + b"2" * 100_000)
    with pytest.raises(InputError, match="line 3: more than 1000 bytes without a line end"):
        TextSource(path)
    packed = write(tmp_path, gzip.compress(b"range\n" + b"1" * 100_000, mtime=0), "drive.csv.gz")
    with pytest.raises(InputError, match="line 2: more than 1000 bytes"):
        TextSource(packed)


@given(
    lines=st.lists(
        st.sampled_from(["", "#", "# a,b", "  ", " \t# c", "\r", "#\r", "\x0b", "\x0c#", "#1,2"]),
        max_size=9,
    ),
    mark=st.sampled_from(["", "\ufeff"]),
    ending=st.sampled_from(["\n", "\r\n", "\r\r\n"]),
    ends=st.booleans(),
    block_bytes=st.integers(1, 60),
)
def test_rows_are_found_among_any_lines_that_are_none(
    tmp_path_factory,
    lines,
    mark,
    ending,
    ends,
    block_bytes,
):
    every = [*lines, "range,time", *lines, "1,2", *lines, "3,4"]
    path = write(tmp_path_factory.mktemp("text"), mark + ending.join(every) + ending * ends)
    text = find_format(path, None)
    assert (text.header_line, text.names) == (len(lines) + 1, ("range", "time"))
    columns = read(TextSource(path, None, block_bytes), "range", "time")
    np.testing.assert_array_equal(columns["range"], [1.0, 3.0])
    np.testing.assert_array_equal(columns["time"], [2.0, 4.0])


@pytest.mark.parametrize("cell", ['"1\r2"', '"1"\r2', '"' + "1" * 140_000 + '"x'])
def test_quoted_cells_that_no_table_has_are_refused_in_one_line(tmp_path, cell):
    path = tmp_path / "a.csv"
    path.write_text("line,column,range\n0,0,5\n" + f"0,1,{cell}\n", newline="")
    with pytest.raises(InputError, match="line 3"):
        list(Input.of(path).records().chunks(("range",)))
