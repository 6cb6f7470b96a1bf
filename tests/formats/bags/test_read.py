"""Bags: every message a scan line, whatever the container, and the same values as other readers
get."""

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from prc_cli.core import process
from prc_cli.core.blocks import join
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.bags.containers import Message, Topic
from prc_cli.formats.bags.messages import OUSTER, VELODYNE
from prc_cli.formats.bags.read import BagStream, _TopicReader
from prc_cli.formats.options import InputConfig
from tests.formats.bags import recordings as made
from tests.formats.packets.captures import vlp16
from tests.fuzz.crafted import KEPT


def read(path: Path, **changes: Any) -> tuple[BagStream, list[ScanBlock]]:
    stream = BagStream(path, InputConfig(**changes))
    return stream, list(stream.blocks())


@pytest.mark.skipif(sys.platform != "linux", reason="limits are for Linux")
@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_a_message_that_grows_beyond_measure_is_refused(tmp_path, name, monkeypatch):
    path = tmp_path / name
    version = 1 if name == "a.bag" else 2
    (long, *_) = made.lasers(version)
    long.message.ranges = np.zeros(25 << 20, np.float32)
    made.write_bag(path, [long], "lz4") if version == 1 else made.write_mcap(path, [long], "zstd")
    assert path.stat().st_size < 1 << 20
    del long
    monkeypatch.setattr(process._State, "limits_hold", True)
    monkeypatch.setattr(process, "SPARE_BYTES", 20 << 20)
    with pytest.raises(InputError, match="takes too much memory for its size"):
        read(path)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_the_extra_is_named(tmp_path, monkeypatch, name):
    for module in ("rosbags", "rosbags.rosbag1", "rosbags.rosbag2"):
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(
        InputError, match=r"needs rosbags, which is not installed; pip install .\.\[ros\]."
    ):
        BagStream(tmp_path / name, InputConfig())


def test_a_database_whose_pages_point_to_one_child():
    """Some 10^13 rows in five pages."""
    stream, blocks = read(KEPT / "endless.db3")
    assert "can be read up to message" in stream.info.facts.notes[0]
    assert join(blocks).n_lines == 3


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(
    "name, m, missing",
    [("40p", 40, 0.247), ("64", 64, 0.225), ("qt64", 64, 0.037), ("vlp32", 32, 0.499)],
)
def test_the_samples_of_every_model_have_the_points_of_another_decoder(real_data, name, m, missing):
    """The points beside a bag are those of one of its scans, as tier4/nebula decodes them."""
    folder = real_data / "nebula" / name
    (path,) = folder.glob("*.db3")
    (cloud,) = folder.glob("*.pcd")
    block = join(read(path)[1])
    assert block.points_per_line == m
    assert float(np.isnan(block.range_m).mean()) == pytest.approx(missing, abs=1e-3)
    assert block.xyz_m is not None
    data = cloud.read_bytes()
    theirs = np.frombuffer(data[data.index(b"DATA binary\n") + 12 :], "<f4").reshape(-1, 3)[::20]
    if name == "vlp32":  # its x axis is a quarter turn behind ours
        theirs = np.stack([-theirs[:, 1], theirs[:, 0], theirs[:, 2]], axis=1)

    def scaled(xyz: np.ndarray) -> np.ndarray:
        """Range [mm], elevation [thousandths of a degree], azimuth in steps of 0.44 degrees."""
        x, y, z = xyz.astype(np.float64).T
        flat = np.hypot(x, y)
        turned = np.stack([x, y]) / flat / np.deg2rad(0.44)
        return np.stack([1e3 * np.hypot(flat, z), 1e3 * np.rad2deg(np.arctan2(z, flat)), *turned]).T

    extra = block.extra
    further = extra.range_m / block.range_m[extra.line, extra.column]
    more = block.xyz_m[extra.line, extra.column] * further[:, None]
    ours = np.concatenate([block.xyz_m[np.isfinite(block.range_m)], more])
    tree = cKDTree(scaled(ours))
    distance, _ = tree.query(scaled(theirs), p=np.inf, distance_upper_bound=1.1)
    assert np.isfinite(distance).mean() > 0.99


def test_packets_of_a_message_have_records_of_their_own(tmp_path):
    topic = Topic("/packets", VELODYNE, is_cdr=False)
    reader = _TopicReader(tmp_path / "a.bag", topic, {}, InputConfig())
    packets = vlp16(6)
    record = 0
    blocks = []
    for first in (0, 3):
        body = b"".join(struct.pack("<II", 9, n) + packets[first + n] for n in range(3))
        data = struct.pack("<IIII", 0, 9, 0, 3) + b"vlp" + struct.pack("<I", 3) + body
        blocks += reader.add(Message(topic, 0, data, 0), record)
        record += reader.n_taken
    records = join([*blocks, *reader.finish()]).records().ravel()
    np.testing.assert_array_equal(np.sort(records), np.arange(6 * 384))


def test_packets_of_an_ouster_need_its_metadata(tmp_path):
    topic = Topic("/packets", OUSTER[1], is_cdr=False)
    reader = _TopicReader(tmp_path / "a.bag", topic, {}, InputConfig())
    data = struct.pack("<I", 3) + b"abc"
    with pytest.raises(InputError, match="packets of an Ouster need its metadata"):
        list(reader.add(Message(topic, 0, data, 0), 0))


def test_echoes_are_returns(tmp_path):
    lists = [[3.0, 5.0], [], [7.0], [0.01, 9.0], [200.0]]
    lit = [[1.0, 8.0], [], [2.0], [9.0, 1.0], [1.0]]
    path = made.write_bag(tmp_path / "echoes.bag", made.echoes(1, lists, lit, n=2))
    (block,) = read(path)[1]
    np.testing.assert_array_equal(block.range_m, [[5, np.nan, 7, 9, np.nan]] * 2)
    np.testing.assert_array_equal(block.records(), [[1, 2, 3, 5, 6], [8, 9, 10, 12, 13]])
    extra = block.extra
    assert [*zip(extra.line, extra.column, extra.range_m, extra.record, strict=True)] == [
        (0, 0, 3, 0),
        (1, 0, 3, 7),
    ]
