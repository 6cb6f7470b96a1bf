"""Bags: every message a scan line, whatever the container, and the same values as other readers
get."""

from __future__ import annotations

import sqlite3
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.core import process
from prc_cli.core.blocks import join
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.bags.containers import Message, Topic
from prc_cli.formats.bags.messages import VELODYNE
from prc_cli.formats.bags.read import BagStream, _TopicReader
from prc_cli.formats.options import InputConfig
from prc_cli.formats.packets.read import PacketStream
from tests.formats.bags import recordings as made
from tests.formats.packets.captures import vlp16
from tests.fuzz.crafted import endless_rows
from tests.runner import runner


def read(path: Path, **changes: Any) -> tuple[BagStream, list[ScanBlock]]:
    stream = BagStream(path, InputConfig(**changes))
    return stream, list(stream.blocks())


def test_echoes_are_returns(tmp_path: Path) -> None:
    store = made.STORES[1]
    lists = [[3.0, 5.0], [], [7.0], [0.01, 9.0], [200.0]]
    lit = [[1.0, 8.0], [], [2.0], [9.0, 1.0], [1.0]]
    kind = "sensor_msgs/msg/MultiEchoLaserScan"
    times = [made.START_NS + i * made.PERIOD_NS for i in range(2)]
    sent = [
        made.Sent("/scan", kind, time_ns, made.echoes(store, time_ns, lists, lit))
        for time_ns in times
    ]
    path = made.write_bag(tmp_path / "echoes.bag", sent)
    (block,) = read(path)[1]
    np.testing.assert_array_equal(block.range_m[0], np.array([5, np.nan, 7, 9, np.nan], np.float32))
    np.testing.assert_array_equal(block.records(), [[1, 2, 3, 5, 6], [8, 9, 10, 12, 13]])
    np.testing.assert_array_equal(block.extra.range_m, np.array([3, 3], np.float32))
    np.testing.assert_array_equal(block.extra.record, [0, 7])
    np.testing.assert_array_equal(block.extra.line, [0, 1])
    (first,) = read(path, **{"return": "first"})[1]
    assert first.range_m[0, 0] == 3
    output = tmp_path / "echoes.csv"
    result = runner().invoke(cli, ["convert", str(path), str(output)])
    assert result.exit_code == 0, result.output + result.stderr
    rows = [row.split(",") for row in output.read_text().split("\n")]
    number = rows[0].index("return_number")
    assert [row[number] for row in rows[1:4]] == ["2", "1", "1"]
    assert block.tally.n_records == 14


def test_clouds_and_laser_scans_are_read_together_but_for_scans_of_a_cloud(tmp_path: Path) -> None:
    sent = [*made.clouds(made.drive()), *made.lasers(2), *made.lasers(2, "/of_cloud", "velodyne")]
    stream, blocks = read(made.write_mcap(tmp_path / "mixed.mcap", sent))
    assert {block.scanner: block.points_per_line for block in blocks} == {0: 8, 1: made.M}
    assumptions = {
        assumption.key: assumption.value + assumption.why for assumption in stream.info.assumptions
    }
    assert assumptions["input.topic"] == "/points, /scanother scans: /of_cloud (input.topic)"
    assert stream.info.facts.scanners == ("/points (velodyne)", "/scan (laser)")
    records = np.concatenate([block.records().ravel() for block in blocks])
    known = np.sort(records[records >= 0])
    assert np.array_equal(known, np.arange(sum(block.tally.n_records for block in blocks)))
    result = runner().invoke(cli, ["info", str(tmp_path / "mixed.mcap")])
    assert "/scan (laser): no vertical direction known" in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("name", "mend"), [("a.bag", "rosbag reindex"), ("a.mcap", "mcap recover")]
)
def test_a_bag_whose_recorder_crashed_names_the_command_that_mends_it(
    tmp_path: Path, name: str, mend: str
) -> None:
    path = tmp_path / name
    whole = (
        made.write_bag(path, made.lasers(1))
        if name == "a.bag"
        else made.write_mcap(path, made.lasers(2))
    )
    path.write_bytes(whole.read_bytes()[:-100])
    with pytest.raises(InputError, match=rf"the bag is damaged .*{mend} \S+/{name}"):
        BagStream(path, InputConfig())


@pytest.mark.skipif(sys.platform != "linux", reason="limits are for Linux")
@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_a_message_that_grows_beyond_measure_is_refused(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    version, path = (1, tmp_path / name) if name == "a.bag" else (2, tmp_path / name)
    row = np.zeros(25 << 20, np.float32)
    long = made.Sent(
        "/scan", "sensor_msgs/msg/LaserScan", 1, made.laser(made.STORES[version], 1, row[:4])
    )
    long.message.ranges = row
    made.write_bag(path, [long], "lz4") if version == 1 else made.write_mcap(path, [long], "zstd")
    assert path.stat().st_size < 1 << 20
    del long, row
    monkeypatch.setattr(process._State, "limits_hold", True)
    monkeypatch.setattr(process, "SPARE_BYTES", 20 << 20)
    with pytest.raises(InputError, match="takes too much memory for its size"):
        read(path)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    for module in ("rosbags", "rosbags.rosbag1", "rosbags.rosbag2"):
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(
        InputError, match=r"needs rosbags, which is not installed; pip install .\.\[ros\]."
    ):
        BagStream(tmp_path / name, InputConfig())


def test_a_database_that_is_not_whole(tmp_path: Path) -> None:
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


def test_set_ups_that_change_are_refused(tmp_path: Path) -> None:
    store = made.STORES[2]
    sent = made.lasers(2)
    later = made.START_NS + 40 * made.PERIOD_NS
    for changes, expected in (
        (
            {"angle_increment": 0.2},
            "message 12: found angle_increment 0.2, expected about 0.0769231",
        ),
        ({"angle_increment": -3.0 / 39}, "message 12: found angle_increment -0.0769231"),
    ):
        odd = made.laser(store, later, made.ranges()[0], **changes)
        path = tmp_path / f"{len(expected)}.db3"
        made.write_db3(path, [*sent, made.Sent("/scan", sent[0].kind, later, odd)])
        with pytest.raises(InputError, match=expected):
            read(path)


def test_hostile_containers_end_in_one_line(tmp_path: Path) -> None:
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


@pytest.mark.parametrize("table", ["topics", "messages"])
def test_a_database_whose_pages_point_to_one_child(tmp_path: Path, table: str) -> None:
    path = endless_rows(made.write_db3(tmp_path / "a.db3", made.lasers(2)), table)
    if table == "topics":
        with pytest.raises(InputError, match="damaged .row 1 comes after row 1"):
            BagStream(path, InputConfig())
    else:
        stream, blocks = read(path)
        assert "can be read up to message" in stream.info.facts.notes[0]
        assert join(blocks).n_lines == made.N_LINES


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "m", "missing"),
    [
        ("40p", 40, 0.247),
        ("64", 64, 0.225),
        ("qt64", 64, 0.037),
        ("vlp32", 32, 0.499),
        ("vls128", 128, 0.099),
    ],
)
def test_the_samples_of_every_model_have_the_points_of_another_decoder(
    real_data: Path,
    name: str,
    m: int,
    missing: float,
) -> None:
    """The points beside a bag are those of one of its scans, as tier4/nebula decodes them (VLS-128:
    of another bag)."""
    folder = real_data / "nebula" / name
    (path,) = folder.glob("*.db3")
    (cloud,) = folder.glob("*.pcd")
    block = join(read(path)[1])
    assert block.points_per_line == m
    assert float(np.isnan(block.range_m).mean()) == pytest.approx(missing, abs=1e-3)
    data = cloud.read_bytes()
    points = (
        np.frombuffer(data[data.index(b"DATA binary\n") + 12 :], "<f4")
        .reshape(-1, 3)
        .astype(np.float64)
    )
    length = np.linalg.norm(points, axis=1)
    elevation = np.rad2deg(np.arcsin(points[:, 2] / length))
    assert block.xyz_m is not None
    x, y, z = block.xyz_m.astype(np.float64).transpose(2, 0, 1)
    of_ring = np.rad2deg(
        np.nanmedian(np.arctan2(z, np.hypot(x, y))[:, np.isfinite(z).any(axis=0)], axis=0)
    )
    rings = np.flatnonzero(np.isfinite(z).any(axis=0))
    nearest = np.abs(elevation[:, None] - of_ring).argmin(axis=1)
    assert np.abs(elevation - of_ring[nearest]).max() < 1e-3
    if name == "vls128":
        return
    # its x axis is ours for Hesai, and a quarter turn on for Velodyne
    turned = np.rad2deg(np.arctan2(points[:, 1], points[:, 0])) + (90 if name == "vlp32" else 0)
    azimuth = np.rad2deg(np.arctan2(y, x))
    step = 360.0 / 0.1 * np.nanmedian(np.diff(block.time_s[:, rings[0]]))  # type: ignore[index]
    ring = np.concatenate([np.broadcast_to(np.arange(m), x.shape).ravel(), block.extra.column])
    ranges = np.concatenate([block.range_m.ravel(), block.extra.range_m]).astype(np.float64)
    azimuths = np.concatenate([azimuth.ravel(), azimuth[block.extra.line, block.extra.column]])
    off: list[float] = []
    for number, ring_number in enumerate(rings):
        mine = (ring == ring_number) & np.isfinite(ranges)
        its = np.flatnonzero(nearest == number)[::20]
        # cells by their range in millimetres, then the one of the nearest azimuth
        order = np.argsort(ranges[mine])
        low, high = (np.searchsorted(ranges[mine][order], length[its] + by) for by in (-1e-3, 1e-3))
        off += [
            np.abs((azimuths[mine][order][a:b] - angle + 180) % 360 - 180).min(initial=360.0)
            for a, b, angle in zip(low, high, turned[its], strict=True)
        ]
    assert float(np.mean(np.array(off) < 1.1 * step)) > 0.99


def test_packets_of_a_message_have_records_of_their_own(tmp_path: Path) -> None:
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


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", ["velodyne_vlp16", "OS-1-128_v2.3.0_1024x10_lb_n3"])
def test_a_cloud_has_the_cells_of_its_packets(real_data: Path, tmp_path: Path, name: str) -> None:
    """Points as drivers publish them, without empty cells, give the lines that the packets give."""
    packets = join(list(PacketStream(real_data / "pcap" / f"{name}.pcap", InputConfig()).blocks()))
    assert packets.xyz_m is not None
    assert packets.time_s is not None
    line, ring = np.nonzero(np.isfinite(packets.range_m))
    time_s = packets.time_s[line, ring]
    since_s = time_s - time_s.min()
    shots = {
        "column": (since_s // made.COLUMN_S).astype(int),
        "ring": ring,
        "range": packets.range_m[line, ring],
        "xyz": packets.xyz_m[line, ring],
        "time": since_s,
    }
    sent = made.clouds(shots, every=200, by_ring=False)
    block = join(read(made.write_db3(tmp_path / "a.db3", sent))[1])
    first = int(line.min())
    offset = [
        k for k in range(-30, 31) if _equal(block.range_m, packets.range_m[first:], k) > 0.999
    ]
    assert len(offset) == 1


def _equal(a: np.ndarray, b: np.ndarray, k: int) -> float:
    """Share of shots that are the same where one image is k lines behind the other."""
    a = a[max(k, 0) :]
    b = b[max(-k, 0) :]
    n = min(len(a), len(b))
    has = np.isfinite(a[:n]) | np.isfinite(b[:n])
    # the beams of an Ouster begin 16 mm beside the origin of its coordinates
    return float(np.isclose(a[:n], b[:n], rtol=1e-5, atol=0.004)[has].mean())
