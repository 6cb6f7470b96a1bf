"""Bags: every message a scan line, whatever the container, and the same values as other readers
get."""

import sqlite3
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


def test_echoes_are_returns(tmp_path):
    lists = [[3.0, 5.0], [], [7.0], [0.01, 9.0], [200.0]]
    lit = [[1.0, 8.0], [], [2.0], [9.0, 1.0], [1.0]]
    path = made.write_bag(tmp_path / "echoes.bag", made.echoes(1, lists, lit, n=2))
    (block,) = read(path)[1]
    np.testing.assert_array_equal(block.range_m[0], np.array([5, np.nan, 7, 9, np.nan], np.float32))
    np.testing.assert_array_equal(block.records(), [[1, 2, 3, 5, 6], [8, 9, 10, 12, 13]])
    np.testing.assert_array_equal(block.extra.range_m, np.array([3, 3], np.float32))
    np.testing.assert_array_equal(block.extra.record, [0, 7])
    np.testing.assert_array_equal(block.extra.line, [0, 1])
    (first,) = read(path, **{"return": "first"})[1]
    assert first.range_m[0, 0] == 3
    assert block.tally.n_records == 14


def test_clouds_and_laser_scans_are_read_together_but_for_scans_of_a_cloud(tmp_path):
    sent = [*made.clouds(made.drive()), *made.lasers(2), *made.lasers(2, "/of_cloud", "velodyne")]
    stream, blocks = read(made.write_mcap(tmp_path / "mixed.mcap", sent))
    assert {block.scanner: block.points_per_line for block in blocks} == {0: 8, 1: made.M}
    topics = next(item for item in stream.info.assumptions if item.key == "input.topic")
    assert (topics.value, topics.why) == ("/points, /scan", "other scans: /of_cloud (input.topic)")
    assert stream.info.facts.scanners == ("/points (velodyne)", "/scan (laser)")
    records = np.concatenate([block.records().ravel() for block in blocks])
    known = np.sort(records[records >= 0])
    assert np.array_equal(known, np.arange(sum(block.tally.n_records for block in blocks)))


@pytest.mark.parametrize("name, mend", [("a.bag", "rosbag reindex"), ("a.mcap", "mcap recover")])
def test_a_bag_whose_recorder_crashed_names_the_command_that_mends_it(tmp_path, name, mend):
    path = tmp_path / name
    if name == "a.bag":
        made.write_bag(path, made.lasers(1))
    else:
        made.write_mcap(path, made.lasers(2))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=rf"the bag is damaged .*{mend} \S+/{name}"):
        BagStream(path, InputConfig())


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


def test_a_database_that_is_not_whole(tmp_path):
    path = made.write_db3(tmp_path / "a.db3", made.lasers(2))
    data = path.read_bytes()
    (tmp_path / "a.db3-wal").write_bytes(b"more")
    assert "messages of a.db3-wal are not read" in read(path)[0].info.facts.notes[0]
    # SQLite quotes what it does not understand, and Python cannot decode the quotation
    path.write_bytes(data.replace(b"PRIMARY KEY,name", b"PRIMARY \xccEY,name"))
    with pytest.raises(InputError, match="the bag is damaged"):
        BagStream(path, InputConfig())
    path.write_bytes(data[:-4096])
    with pytest.raises(InputError, match=f"the database is cut: found {len(data) - 4096} bytes"):
        BagStream(path, InputConfig())


@pytest.mark.parametrize(
    "step, expected",
    [(0.2, "0.2, expected about 0.0769231"), (-3.0 / 39, "-0.0769231")],
)
def test_set_ups_that_change_are_refused(tmp_path, step, expected):
    sent = made.lasers(2)
    later = made.START_NS + 40 * made.PERIOD_NS
    odd = made.laser(made.STORES[2], later, made.ranges()[0], angle_increment=step)
    path = made.write_db3(tmp_path / "a.db3", [*sent, made.Sent("/scan", sent[0].kind, later, odd)])
    with pytest.raises(InputError, match=f"message 12: found angle_increment {expected}"):
        read(path)


def test_hostile_containers_end_in_one_line(tmp_path):
    view = tmp_path / "view.db3"
    made.write_db3(view, made.lasers(2))
    base = sqlite3.connect(view)
    base.execute("ALTER TABLE messages RENAME TO other")
    base.execute(
        "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
        "SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data FROM n"
    )
    base.commit()
    base.close()
    with pytest.raises(InputError, match="no plain table 'messages'"):
        BagStream(view, InputConfig())

    for name, expected in (("a.bag", "damaged"), ("a.mcap", "damaged"), ("a.db3", "SQLite")):
        (tmp_path / name).write_bytes(b"something else, long enough")
        with pytest.raises(InputError, match=expected):
            BagStream(tmp_path / name, InputConfig())


def test_a_database_whose_pages_point_to_one_child():
    """Some 10^13 rows in five pages."""
    with pytest.raises(InputError, match="damaged .row 1 comes after row 1"):
        BagStream(KEPT / "endless_topics.db3", InputConfig())
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
