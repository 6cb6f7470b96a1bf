"""Point clouds with ring and time: the firing columns that the packets had."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.bags.read import BagStream
from prc_cli.formats.options import InputConfig
from prc_cli.formats.packets.read import PacketStream
from tests.formats.bags import recordings as made

KIND = "sensor_msgs/msg/PointCloud2"


def read(path: Path, **changes: Any) -> ScanBlock:
    return join(list(BagStream(path, InputConfig(**changes)).blocks()))


def drive(n: int = 300, m: int = 8, seed: int = 5) -> dict[str, np.ndarray]:
    """Shots of a scanner of 8 rings and 200 firings a turn; a fifth did not return."""
    rng = np.random.default_rng(seed)
    column, ring = (each.ravel() for each in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    range_m = rng.uniform(5, 6, n * m)
    range_m[rng.random(n * m) < 0.2] = np.nan
    order = np.array([0, 4, 1, 5, 2, 6, 3, 7])
    time_s = column * 5e-4 + order[ring] * 5e-5
    azimuth, elevation = time_s * 2 * np.pi / 0.1, np.deg2rad(-14 + 4 * ring)
    flat = range_m * np.cos(elevation)
    xyz = np.stack([flat * np.cos(azimuth), -flat * np.sin(azimuth), range_m * np.sin(elevation)], axis=1)
    return {"column": column, "ring": ring, "range": range_m, "xyz": xyz, "time": time_s}


def messages(shots: dict[str, np.ndarray], kinds: str, *, every: int = 100, version: int = 2) -> list[made.Sent]:
    """Messages of 100 columns with the points that returned, ring after ring."""
    sent = []
    for first in range(0, int(shots["column"].max()) + 1, every):
        use = (shots["column"] // every == first // every) & np.isfinite(shots["range"])
        use = np.flatnonzero(use)[np.argsort(shots["ring"][use], kind="stable")]
        start_ns = made.START_NS + round(first * 500_000)
        table = np.zeros(len(use), np.dtype(kinds))
        for axis, name in enumerate("xyz"):
            table[name] = shots["xyz"][use, axis]
        table["ring"] = shots["ring"][use]
        table["intensity"] = shots["column"][use] % 250
        after = shots["time"][use] - first * 5e-4
        name = next(one for one in ("time", "t", "timestamp") if one in (table.dtype.names or ()))
        table[name] = {"f4": after, "u4": np.rint(after * 1e9), "f8": after + start_ns * 1e-9}[
            table.dtype[name].str[1:]
        ]
        sent.append(made.Sent("/points", KIND, start_ns, made.cloud(version, start_ns, table)))
    return sent


@pytest.mark.parametrize("kinds", ["<f4,<f4,<f4,<f4,<u2,<f4", "<f4,<f4,<f4,u1,u1,<u4", ">f8,>f8,>f8,>f4,>i4,>f8"])
def test_columns_come_back_from_times(tmp_path: Path, kinds: str) -> None:
    shots = drive()
    time = {"<f4": "time", "<u4": "t", ">f8": "timestamp"}[kinds.rpartition(",")[2]]
    names = ["x", "y", "z", "intensity", "ring", time]
    dtype = np.dtype(list(zip(names, kinds.split(","), strict=True)))
    block = read(made.write_mcap(tmp_path / "a.mcap", messages(shots, dtype)))
    wanted = shots["range"].reshape(300, 8)
    np.testing.assert_allclose(block.range_m, wanted, rtol=1e-5)
    assert block.time_s is not None
    np.testing.assert_allclose(block.time_s - made.START_NS * 1e-9, shots["time"].reshape(300, 8), atol=1e-6)
    assert block.tally.n_records == np.isfinite(wanted).sum()
    records = block.records()
    assert np.array_equal(np.sort(records[records >= 0]), np.arange(np.isfinite(wanted).sum()))


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
    dtype = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("t", "<u4")])
    sent = []
    first_s = time_s.min()
    turn = ((time_s - first_s) // 0.1).astype(int)
    for one in range(turn.max() + 1):
        use = turn == one
        table = np.zeros(np.count_nonzero(use), dtype)
        for axis, key in enumerate("xyz"):
            table[key] = packets.xyz_m[line[use], ring[use], axis]
        table["ring"] = ring[use]
        table["t"] = np.rint((time_s[use] - first_s - 0.1 * one) * 1e9)
        start_ns = made.START_NS + one * 100_000_000
        sent.append(made.Sent("/points", KIND, start_ns, made.cloud(2, start_ns, table)))
    block = read(made.write_db3(tmp_path / "a.db3", sent))
    first = int(line.min())
    offset = [k for k in range(-30, 31) if _equal(block.range_m, packets.range_m[first:], k) > 0.999]
    assert len(offset) == 1


def _equal(a: np.ndarray, b: np.ndarray, k: int) -> float:
    """Share of shots that are the same where one image is k lines behind the other."""
    a, b = a[max(k, 0) :], b[max(-k, 0) :]
    n = min(len(a), len(b))
    has = np.isfinite(a[:n]) | np.isfinite(b[:n])
    # the beams of an Ouster begin 16 mm beside the origin of its coordinates
    return float(np.isclose(a[:n], b[:n], rtol=1e-5, atol=0.004)[has].mean())
