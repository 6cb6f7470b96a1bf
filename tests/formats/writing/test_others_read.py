"""What is written is read by programs that share nothing with this one."""

import csv
import gzip
import io
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from rosbags.highlevel import AnyReader

from prc_cli.config import resolve
from prc_cli.core.blocks import join
from prc_cli.formats.registry import by_suffix
from prc_cli.formats.testing import example
from prc_cli.streams.open import open_input
from tests.formats.common import run_record


def _las(path: Path) -> int:
    with laspy.open(path) as reader:
        assert len(reader.read().points) == reader.header.point_count
        return int(reader.header.point_count)


def _csv(text: str) -> int:
    rows = list(csv.reader(io.StringIO(text)))
    assert len({len(row) for row in rows}) == 1
    return len(rows) - 1


def _zst(path: Path) -> int:
    with pa.input_stream(str(path), compression="zstd") as stream:
        return _csv(stream.read().decode())


def _array(path: Path) -> int:
    loaded = np.load(path, allow_pickle=False)
    return int((loaded["range_m"] if path.suffix == ".npz" else loaded).size)


def _dump(path: Path) -> int:
    layout = tomllib.loads(path.with_name(f"{path.name}.toml").read_text())["layout"]
    kind = np.dtype([(field["name"], f"<{field['type']}") for field in layout["fields"]])
    return len(np.fromfile(path, kind))


def _cloud(path: Path) -> int:
    word = rb"element vertex (\d+)" if path.suffix == ".ply" else rb"POINTS (\d+)"
    match = re.search(word, path.read_bytes()[:2000])
    assert match is not None
    return int(match[1])


def _bag(path: Path) -> int:
    with AnyReader([path.parent if path.suffix == ".db3" else path]) as reader:
        scans = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
            if connection.topic == "/scan"
        ]
    return sum(len(scan.ranges) for scan in scans)


READERS: dict[str, Callable[[Path], int]] = {
    ".las": _las,
    ".laz": _las,
    ".csv": lambda path: _csv(path.read_text()),
    ".csv.zst": _zst,
    ".csv.gz": lambda path: _csv(gzip.decompress(path.read_bytes()).decode()),
    ".npz": _array,
    ".npy": _array,
    ".parquet": lambda path: parquet.read_table(path).num_rows,
    ".bin": _dump,
    ".ply": _cloud,
    ".pcd": _cloud,
    ".bag": _bag,
    ".mcap": _bag,
    ".db3": _bag,
}


@pytest.mark.parametrize("suffix", sorted(by_suffix("streams")))
def test_every_stream(tmp_path, suffix):
    path = tmp_path / f"o{suffix}"
    form = by_suffix("streams")[suffix]
    item, shape = example(form)
    with form.stream_writer(path, shape) as writer:
        writer.add_item(item)
        writer.finish(run_record())
    ranges = item.block.range_m
    assert READERS[suffix](path) in {ranges.size, np.count_nonzero(np.isfinite(ranges))}


def test_a_dump_is_read_by_the_configuration_beside_it(tmp_path):
    path = tmp_path / "o.bin"
    item, shape = example(by_suffix("streams")[".bin"])
    with by_suffix("streams")[".bin"].stream_writer(path, shape) as writer:
        writer.add_item(item)
        writer.finish(run_record())
    scan, loaded = resolve(path)
    stream = open_input(scan, loaded.config.input)
    np.testing.assert_array_equal(join(list(stream.blocks())).range_m, item.block.range_m)
    np.testing.assert_allclose(stream.info.angle_rad, item.block.angle_rad)
