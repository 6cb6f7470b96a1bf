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
        ("range,x\n1,2\n\n# c\nabc,3\n", "line 5: column 'range': found 'abc', expected a number"),
        ("range,x\r\n1,2\r\n3,4,5\r\n", "line 3: 3 cells, expected 2 as in line 1: '3,4,5'"),
        ("range\n1\n# c\n  \n2\n", "line 4: a blank line between rows of one column"),
    ],
)
def test_errors_name_the_line_and_the_text_whatever_the_blocks(tmp_path, content, message):
    with pytest.raises(InputError, match=message):
        read(TextSource(write(tmp_path, content), block_bytes=5), "range")


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
