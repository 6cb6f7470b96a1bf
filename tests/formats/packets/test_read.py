"""Packets of spinning scanners.

Every cell as independent decoders have it, whatever the capture.
"""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import velodyne_decoder

from prc_cli.core.blocks import join
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.options import InputConfig
from prc_cli.formats.packets import spinning
from prc_cli.formats.packets.read import PacketStream
from tests.formats.packets import captures as made


def read(path: Path, **changes: Any) -> tuple[PacketStream, ScanBlock]:
    stream = PacketStream(path, InputConfig(**changes))
    return stream, join(list(stream.blocks()))


def same(a: ScanBlock, b: ScanBlock, *, times: bool = True) -> None:
    for name in ("range_m", "xyz_m", "intensity", "record", *(("time_s",) if times else ())):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_captures_of_every_kind_are_the_same(tmp_path):
    packets = made.vlp16()
    frames = made.framed(packets)
    _, plain = read(made.write_pcap(tmp_path / "a.pcap", frames))
    stream, twice = read(made.write_pcap(tmp_path / "twice.pcap", frames + frames))
    np.testing.assert_array_equal(twice.range_m, plain.range_m)
    assert twice.tally.n_records == 2 * plain.tally.n_records
    assert stream.info.facts.repeated

    def sent(frame: Callable[[bytes], bytes]) -> list[tuple[float, bytes]]:
        """The packets in other frames."""
        return [(frames[k][0], frame(made.udp(packet))) for k, packet in enumerate(packets)]

    tagged = sent(lambda body: made.ethernet(made.ip4(body), vlan=True))
    six = sent(lambda body: made.ethernet(made.ip6(body)))
    for again in (
        made.write_pcap(tmp_path / "b.pcap", frames, order=">"),
        made.write_pcap(tmp_path / "c.pcap", tagged),
        made.write_pcap(tmp_path / "d.pcap", six),
        made.write_pcap(tmp_path / "raw.pcap", sent(made.ip4), link=101),
    ):
        same(plain, read(again)[1])
    # times are finer there
    for again in (
        made.write_pcap(tmp_path / "e.pcap", frames, nano=True),
        made.write_pcapng(tmp_path / "f.pcapng", frames),
        made.write_pcapng(tmp_path / "g.pcapng", frames, order=">"),
    ):
        same(plain, read(again)[1], times=False)


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


def test_packets_that_overtook_each_other_are_put_in_order(tmp_path):
    frames = made.framed(made.vlp16())
    _, whole = read(made.write_pcap(tmp_path / "a.pcap", frames))
    swapped = [*frames[:5], frames[6], frames[5], *frames[7:]]
    _, block = read(made.write_pcap(tmp_path / "b.pcap", swapped))
    np.testing.assert_array_equal(block.range_m, whole.range_m)
    assert block.tally.n_unplaced == 0


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


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"pixels_per_column": 5}, "beam_azimuth_angles: found list of 4, expected 5 numbers"),
        (
            {"pixel_shift_by_row": [0, 10**400, 0, 0]},
            "pixel_shift_by_row: found 10000.*, expected 4 numbers",
        ),
        ({"udp_profile_lidar": ["NEW"]}, "udp_profile_lidar: found .'NEW'., expected one of"),
        ({"udp_profile_lidar": "NEW"}, "udp_profile_lidar: found NEW, expected one of LEGACY"),
        ({"columns_per_packet": 8}, "no packets of a known scanner: 16 of 1024 bytes to port 7502"),
        ({"lidar_origin_to_beam_origin_mm": 1000}, "found 1000, expected millimetres"),
        ({"columns_per_frame": "x"}, "found x, expected a whole number from 1 to 4096"),
    ],
)
def test_metadata_that_do_not_fit_are_refused(tmp_path, changes, message):
    table, packets = made.ouster()
    for part in (table, table["data_format"]):
        part.update({name: value for name, value in changes.items() if name in part})
    path = made.write_pcap(tmp_path / "a.pcap", made.framed(packets, 7502))
    path.with_suffix(".json").write_text(json.dumps(table))
    with pytest.raises(InputError, match=message):
        PacketStream(path, InputConfig())


def test_metadata_that_are_not_there_are_asked_for(tmp_path):
    path = made.write_pcap(tmp_path / "a.pcap", made.framed(made.ouster()[1], 7502))
    with pytest.raises(InputError, match="metadata") as caught:
        PacketStream(path, InputConfig())
    assert "give --set input.metadata=FILE.json" in f"{caught.value} {caught.value.hint}"
    with pytest.raises(InputError, match="cannot be read as JSON"):
        PacketStream(path, InputConfig(metadata=str(tmp_path / "no.json")))


XT16 = made.hesai("XT16")[0][0]


@pytest.mark.parametrize(
    "packets, message",
    [
        (
            made.vlp16(model=0x23),
            r"model 0x23 \(VLP-32A or VLP-32B\), expected Velodyne HDL-32E, Velodyne VLP-16",
        ),
        (
            [XT16[:2] + b"\4\3" + XT16[4:]],
            r"Hesai, protocol 4.3, 16 channels in 8 blocks, 568 bytes\), expected",
        ),
        (
            made.velodyne(3, 0x40),
            r"HDL-64E need the calibration of the unit; give --set input.metadata=FILE.yml",
        ),
        (made.hesai("XT32M", mode=0x3D)[0], r"three returns a shot \(mode 0x3d\), expected one"),
        (made.vlp16(5) + made.vlp16(5, mode=0x38), "return mode 0x38 after 0x22 and 0x37"),
    ],
)
def test_packets_that_cannot_be_read_are_named(tmp_path, packets, message):
    with pytest.raises(InputError, match=message):
        read(made.write_pcap(tmp_path / "a.pcap", made.framed(packets)))


@pytest.mark.parametrize(
    "data, message",
    [
        (b"no capture", "begins with 6e6f2063, expected a capture"),
        (
            struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1) + b"\xff" * 100,
            "found a packet of 4294967295 bytes, expected at most 262144",
        ),
    ],
)
def test_what_is_no_capture_is_refused(tmp_path, data, message):
    (tmp_path / "a.pcap").write_bytes(data)
    with pytest.raises(InputError, match=message):
        PacketStream(tmp_path / "a.pcap", InputConfig())


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
    packets, units = made.hesai(name, 40, mode=mode, column_us=COLUMNS_US.get(name, 50.0))
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


COLUMNS_US = {
    "40P": 55.56,
    "64": 55.56,
    "QT64": 166.67,
    "QT128": 111.11,
    "128": 55.556,
    "OT128": 55.556,
}
