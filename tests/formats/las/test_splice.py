"""New classes in LAZ chunks: the same bytes as from compressing everything again."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import InputError, PrcError
from prc_cli.formats.las import rewrite as las_rewrite
from prc_cli.formats.las import splice as las_splice
from prc_cli.formats.las.header import open_bytes, read_header
from prc_cli.formats.las.read import LasSource
from prc_cli.formats.las.splice import Splice, contexts_of, find_chunks, records_of
from tests.formats.common import URBAN, random_labels, record_blocks, run_record, write, writer
from tests.formats.las.lasbytes import (
    Parsed,
    Raw,
    classes,
    field,
    make_las,
    make_laz,
    n_points,
    parse,
    random_laz,
    same_but_class,
)


def chunks_of(path: Path) -> Splice | None:
    with open_bytes(path) as source:
        return find_chunks(source, read_header(source))


def labelled_copy(source: Path, output: Path) -> tuple[Parsed, np.ndarray]:
    labels = random_labels(n_points(source.read_bytes()))
    write(output, source, record_blocks(labels))
    return parse(output), ClassCodes().lookup()[labels]


def test_records_have_the_contexts_that_they_were_made_of():
    records = records_of(np.arange(8, dtype=np.uint8))
    assert contexts_of(records).tolist() == list(range(8))
    assert (records[:, 15] >> 4).tolist() == 2 * [0, 1, 2, 3]


@pytest.mark.parametrize(
    "n, chunk_points", [(1, 50), (50, 50), (51, 50), (1030, 50), (7, 1), (300, 50_000)]
)
@pytest.mark.parametrize("form", [6, 7, 8])
def test_bytes_are_those_of_compressing_everything(
    tmp_path,
    monkeypatch,
    form,
    n,
    chunk_points,
):
    source = tmp_path / "in.laz"
    old = make_laz(source, form, n, chunk_points, seed=form)
    assert chunks_of(source) is not None
    # several batches, the last one not full
    monkeypatch.setattr(las_splice, "batch_records", lambda length, *, compressed: 4 * 50)
    spliced, codes = labelled_copy(source, tmp_path / "spliced.laz")
    monkeypatch.setattr(las_rewrite, "find_chunks", lambda *_: None)
    again, _ = labelled_copy(source, tmp_path / "again.laz")
    assert spliced.data == again.data
    same_but_class(old, spliced)
    assert np.array_equal(classes(spliced), codes)


@pytest.mark.parametrize("offset, lie", [(0, 49), (4, 3_000_000)])
def test_chunks_whose_heads_lie_are_left_to_the_decoder(tmp_path, offset, lie):
    """The number of records of a chunk, or the length of a layer."""
    source = tmp_path / "in.laz"
    make_laz(source, 6, 200, 50)
    chunks = chunks_of(source)
    assert chunks is not None
    data = bytearray(source.read_bytes())
    first = chunks.chunks.table.first_byte[1] + field(bytes(data), 105, "H")
    struct.pack_into("<I", data, first + offset, lie)
    source.write_bytes(data)
    assert chunks_of(source) is None


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_an_input_that_changes_between_the_readings_is_refused(tmp_path, suffix):
    source = tmp_path / f"in{suffix}"
    output = tmp_path / f"out{suffix}"
    make_las(source, 6)
    with (
        pytest.raises(InputError, match="changed while it was read"),
        writer(output, source) as opened,
    ):
        for block in record_blocks(random_labels(300)):
            opened.add(block)
        os.utime(source, ns=(0, 1_700_000_000_000_000_000))
        opened.finish(run_record())
    assert list(tmp_path.glob(f"*out{suffix}*")) == []


def classify_again(
    source: Path,
    output: Path,
    labels: Raw,
    *,
    kept: bool = False,
) -> bytes | None:
    """Return the output, None where the input is refused."""
    try:
        contexts = None
        if kept:
            opened = LasSource(source, chunk_records=100)
            for _ in opened.chunks(("x",)):
                pass
            contexts = opened.laz_contexts
            assert contexts is not None
            assert contexts.n_seen == len(labels)
        write(output, source, record_blocks(labels), laz_contexts=contexts)
    except PrcError:
        return None
    return output.read_bytes()


@pytest.mark.parametrize("damaged", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_three_ways_to_the_same_bytes(
    tmp_path,
    monkeypatch,
    seed,
    damaged,
):
    rng = np.random.default_rng(seed)
    source = tmp_path / "in.laz"
    random_laz(source, rng)
    n = n_points(source.read_bytes())
    labels = random_labels(n, URBAN if seed % 3 else URBAN[1:2], seed)
    if damaged:
        data = bytearray(source.read_bytes())
        first = field(bytes(data), 96, "I") + 8
        position = int(rng.integers(first, struct.unpack_from("<q", data, first - 8)[0]))
        data[position] ^= int(rng.integers(1, 256))
        source.write_bytes(data)
    monkeypatch.setattr(las_splice, "batch_records", lambda *_, **__: 120)
    kept = classify_again(source, tmp_path / "kept.laz", labels, kept=True)
    if damaged and kept is None:
        # refused by the reader, which checks what chunks claim before the decoder takes memory for
        # it
        return
    spliced = classify_again(source, tmp_path / "spliced.laz", labels)
    monkeypatch.setattr(las_rewrite, "find_chunks", lambda *_: None)
    full = classify_again(source, tmp_path / "full.laz", labels)
    if not damaged:
        assert spliced is not None
        assert spliced == kept == full
    elif spliced is not None and full is not None:
        # damage that a decoder does not notice is in both; how it is coded may differ
        records = [parse(tmp_path / name).records for name in ("spliced.laz", "full.laz")]
        np.testing.assert_array_equal(records[0], records[1])
