"""What is written is read by programs that share nothing with this one."""

from __future__ import annotations

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

from prc_cli.formats.registry import by_suffix
from prc_cli.jobs.simulate import simulate
from prc_cli.simulation.settings import load_settings

LINES = 30
M = 200
SETTINGS = {"scanner": {"points_per_line": M}, "lines": LINES, "trajectory": {"stop_every_m": 0.0}}


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
def test_every_stream(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"o{suffix}"
    made = simulate("street", path, load_settings("street", options=SETTINGS))
    n_returns = made.counts.n_shots - made.counts.n_missing
    contents = READERS[suffix](path)
    assert contents in {LINES * M, n_returns, n_returns + made.counts.n_extra}
