"""Packets of spinning scanners.

Every cell as independent decoders have it, whatever the capture.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import velodyne_decoder

from prc_cli.core.blocks import join
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.options import InputConfig
from prc_cli.formats.packets import spinning
from prc_cli.formats.packets.read import PacketStream
from tests.formats.packets import captures as made


def read(path: Path, **changes: Any) -> tuple[PacketStream, ScanBlock]:
    stream = PacketStream(path, InputConfig(**changes))
    return stream, join(list(stream.blocks()))


def same(a: ScanBlock, b: ScanBlock) -> None:
    for name in ("range_m", "xyz_m", "intensity", "record", "time_s"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_fragments_are_put_together(tmp_path, monkeypatch):
    packets = made.vlp16()
    _, plain = read(made.write_pcap(tmp_path / "a.pcap", made.framed(packets)))
    frames = []
    for i, (time_s, _) in enumerate(made.framed(packets)):
        body = made.udp(packets[i])
        parts = [(0, body[:480]), (480, body[480:960]), (960, body[960:])]
        if i % 2:
            parts.reverse()
        frames += [
            (time_s, made.ethernet(made.ip4(part, offset=offset, more=offset < 960, number=i)))
            for offset, part in parts
        ]
    _, again = read(made.write_pcap(tmp_path / "b.pcap", frames))
    same(plain, again)
    stream, short = read(made.write_pcap(tmp_path / "c.pcap", frames[:-1]))
    assert short.n_lines == 19 * 24
    assert stream.info.facts.notes == ("1 datagrams lack a fragment: left out",)
    # as many wait as may
    monkeypatch.setattr("prc_cli.formats.packets.capture.MAX_PENDING", len(packets))
    mixed = [frame for k in range(3) for frame in frames[k::3]]
    same(plain, read(made.write_pcap(tmp_path / "d.pcap", mixed))[1])


@pytest.mark.parametrize(
    "profile",
    ["LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG15_RFL8_NIR8", "RNG19_RFL8_SIG16_NIR16_DUAL"],
)
def test_ouster_columns_are_destaggered_in_angle_not_in_time(tmp_path, profile):
    table, packets = made.ouster(profile)
    path = made.write_pcap(tmp_path / "a.pcap", made.framed(packets, 7502))
    path.with_suffix(".json").write_text(json.dumps(table))
    stream, block = read(path, **{"return": "first"})
    assert block.range_m.shape == (242, 4)
    assert block.tally.n_records == 16 * 16 * 4 * (2 if profile.endswith("DUAL") else 1)
    assert block.time_s is not None
    assert block.xyz_m is not None
    # rings from low to high: rows 3, 2, 1, 0, of which 0 and 2 belong two columns behind
    for ring, (row, shift) in enumerate(((3, 0), (2, 2), (1, 0), (0, 2))):
        column = np.arange(240)
        wanted = 1000 * (column // 120 + 1) + column % 120 + 200 * row
        wanted = wanted // 8 * 8 if profile == "RNG15_RFL8_NIR8" else wanted
        ranges = block.range_m[shift : shift + 240, ring]
        np.testing.assert_allclose(ranges, wanted * 1e-3, rtol=1e-6)
        np.testing.assert_allclose(
            block.time_s[shift : shift + 240, ring], column * 1e-3, atol=1e-9
        )
    azimuth = np.rad2deg(
        np.unwrap(np.arctan2(block.xyz_m[4:238, :, 1], block.xyz_m[4:238, :, 0]), axis=1)
    )
    assert np.ptp(azimuth, axis=1).max() < 0.2
    assert len(block.extra) == (480 if profile.endswith("DUAL") else 0)
    assert stream.info.facts.has_line_times


@pytest.mark.parametrize("first, last, every", [(0, 119, 120), (10, 99, 92)])
def test_ouster_columns_outside_the_window_are_not_read(tmp_path, first, last, every):
    table, packets = made.ouster(good=128)
    table["data_format"]["column_window"] = [first, last]
    path = made.write_pcap(tmp_path / "a.pcap", made.framed(packets, 7502))
    path.with_suffix(".json").write_text(json.dumps(table))
    _, block = read(path)
    number = np.arange(first, last + 1)
    wanted = np.full(block.n_lines, np.nan)
    for frame in range(2):
        wanted[frame * every :][: len(number)] = 1000 * (frame + 1) + number + 600
    assert (block.n_lines, block.tally.n_unplaced) == (every + len(number) + 2, 0)
    np.testing.assert_allclose(block.range_m[:, 0], 1e-3 * wanted, rtol=1e-6)


def compare(
    block: ScanBlock,
    points: np.ndarray,
    turned_deg: float,
    off_m: float,
) -> None:
    """Compare shots with the points of velodyne-decoder, ring by ring."""
    assert block.xyz_m is not None
    assert block.intensity is not None
    has = np.isfinite(block.range_m)
    assert has.sum() == len(points)
    for ring in range(block.points_per_line):
        mine = has[:, ring]
        of = points[:, 6] == ring
        assert mine.any() == of.any()
        xyz = block.xyz_m[mine, ring]
        off = np.arctan2(-xyz[:, 0], xyz[:, 1]) - np.arctan2(points[of, 1], points[of, 0])
        assert np.rad2deg(np.abs(np.angle(np.exp(1j * off)))).max(initial=0.0) < turned_deg
        np.testing.assert_allclose(np.hypot(*xyz[:, :2].T), np.hypot(*points[of, :2].T), atol=off_m)
        np.testing.assert_array_equal(block.intensity[mine, ring], points[of, 3])


@pytest.mark.parametrize("model", [0x21, 0x22, 0x24, 0x28, 0xA1, 0x40])
def test_every_velodyne_is_what_velodyne_decoder_reads(tmp_path, model):
    packets = made.velodyne(30, model, firings=2 if model in (0x22, 0x24) else 1)
    path = made.write_pcap(tmp_path / "a.pcap", made.framed(packets))
    config = velodyne_decoder.Config(min_range=0, max_range=1000)
    changes = {}
    if model == 0x40:
        names = ("laser_id", "vert_correction", "rot_correction", "dist_correction")
        rows = [(k, -0.4 + 0.007 * k, 0.02 * (k % 5), 1.5) for k in range(64)]
        lasers = [dict(zip(names, row, strict=True)) for row in rows]
        unit = {"num_lasers": 64, "distance_resolution": 0.002, "lasers": lasers}
        calibration = tmp_path / "unit.yml"
        calibration.write_text(json.dumps(unit))
        config.calibration = velodyne_decoder.Calibration.read(str(calibration))
        config.model = velodyne_decoder.Model.HDL64E_S2
        changes = {"metadata": str(calibration)}
    _, block = read(path, max_gap_lines=10**6, **changes)
    points = np.concatenate([points for _, points in velodyne_decoder.read_pcap(str(path), config)])
    compare(block, points, 0.2, 0.02)
    dual = made.velodyne(30, model, mode=0x39, firings=2 if model in (0x22, 0x24) else 1)
    if model != 0x40:
        _, both = read(made.write_pcap(tmp_path / "b.pcap", made.framed(dual)), max_gap_lines=10**6)
        assert both.points_per_line == block.points_per_line
        assert len(both.extra) > 0.7 * np.isfinite(both.range_m).sum()


@pytest.mark.parametrize("name", made.HESAI)
@pytest.mark.parametrize("mode", [0x37, 0x39])
def test_every_hesai_has_the_distances_of_its_packets(tmp_path, name, mode):
    packets, units = made.hesai(name, 40, mode=mode)
    path = made.write_pcap(tmp_path / "a.pcap", made.framed(packets))
    stream, block = read(path, **{"return": "last"})
    assert f"Hesai {name} at" in " ".join(
        assumption.value + assumption.why for assumption in stream.info.assumptions
    )
    table = json.loads((Path(spinning.__file__).parent / "hesai.json").read_text())[name]
    order = np.argsort(table["elevation_deg"], kind="stable")
    metres = np.where(units < 4, np.nan, units * 0.004)[:, order]
    wanted = np.fmax(metres[::2], metres[1::2]) if mode == 0x39 else metres
    shift = np.rint(np.array(table["azimuth_deg"])[order] / 0.2).astype(int)
    shift -= shift.min()
    assert block.n_lines == len(wanted) + shift.max()
    for ring, by in enumerate(shift):
        np.testing.assert_allclose(
            block.range_m[by : by + len(wanted), ring], wanted[:, ring], rtol=1e-6
        )
    assert block.xyz_m is not None
    elevation_deg = np.rad2deg(np.arcsin(block.xyz_m[..., 2] / block.range_m))
    np.testing.assert_allclose(
        np.nanmedian(elevation_deg, axis=0), np.array(table["elevation_deg"])[order], atol=1e-3
    )


def test_nanoseconds_move_no_cell(tmp_path):
    """The times alone are finer; golden row ``captures`` has what is the same to the last bit."""
    frames = made.framed(made.vlp16())
    _, plain = read(made.write_pcap(tmp_path / "a.pcap", frames))
    _, fine = read(made.write_pcap(tmp_path / "b.pcap", frames, nano=True))
    for name in ("range_m", "xyz_m", "intensity", "record"):
        np.testing.assert_array_equal(getattr(fine, name), getattr(plain, name))
    np.testing.assert_allclose(fine.time_s - plain.time_s, 0, atol=1e-6)
