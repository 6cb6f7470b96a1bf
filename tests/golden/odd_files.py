"""Odd files for the golden cases: ``@odd NAME`` runs a function in the folder of a case."""

import json
import sqlite3
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from prc_cli.formats.labels import open_codes
from tests.formats import cloud_files as clouds
from tests.formats import organised_files as organised
from tests.formats.bags import recordings as bag
from tests.formats.las import lasbytes as lasfile
from tests.formats.packets import captures as packet
from tests.golden.inputs import frame

ONES = np.ones((7, 5))


# ---- arrays and tables


def save(**arrays: Any) -> None:
    """Write every array as .npy, and alone in an .npz."""
    for name, array in arrays.items():
        np.save(name, array)
        np.savez(name, range_m=array)


def kinds() -> None:
    """Write arrays that are no numbers, or of a shape that no scan has."""
    save(
        complex=np.ones((2, 3), complex),
        text=np.array([["a", "b"]]),
        bool=np.ones((2, 3), bool),
        record=np.zeros((2, 3), [("range", "f4"), ("t", "f8")]),
        cube=np.ones((2, 3, 4)),
        point=np.ones(()),
        no_lines=np.ones((0, 3)),
        no_columns=np.ones((3, 0)),
        row=np.ones(6),
    )


def beside() -> None:
    """Write ranges with arrays beside them that do not fit."""
    np.savez("few", range_m=ONES, angle_deg=np.zeros(4))
    np.savez("nan", range_m=ONES, angle_deg=np.array([0, 1, np.nan, 3, 4]))
    np.savez("text", range_m=ONES, angle_deg=np.array(["a"] * 5))
    np.savez("time", range_m=ONES, time_s=np.zeros(6))
    np.savez("xyz", range_m=ONES, xyz=np.zeros((7, 5, 2)))
    np.savez("intensity", range_m=ONES, intensity=np.zeros((5, 7)))
    np.savez("class", range_m=ONES, **{"class": np.zeros((7, 5), bool)})


def names() -> None:
    """Write archives whose ranges have no usual name, or are none."""
    image = np.random.default_rng(1).uniform(2, 9, (12, 8))
    np.savez("one", depth=image)
    np.savez("two", depth=image, near=image)
    np.savez("xyz", xyz=np.stack([image, 0 * image, image], axis=2))
    np.savez("turned", range_m=image.T, zenith_deg=np.arange(8) * 5.0, speed=image)


def rows() -> None:
    """Write ranges in a row, and class codes and records that look like it."""
    ranges = np.arange(1, 101, dtype="f4") / 10
    np.save("a", ranges)
    np.save("codes", np.arange(9, dtype="u1"))
    np.savez("records", range_m=ranges, scan_line=np.arange(100) // 10, column=np.arange(100) % 10)


def archives() -> None:
    """Write archives that are locked, or packed in another way."""
    np.savez("a", range_m=ONES)
    data = bytearray(Path("a.npz").read_bytes())
    data[data.rfind(b"PK\1\2") + 8] |= 1
    Path("locked.npz").write_bytes(data)
    with zipfile.ZipFile("a.npz") as plain, zipfile.ZipFile("b.npz", "w", zipfile.ZIP_LZMA) as out:
        out.writestr("range_m.npy", plain.read("range_m.npy"))


def codes() -> None:
    """Write arrays of class codes, all but the first two of which are none."""
    values: dict[str, Any] = {
        "a": np.reshape([2, 2, 7, 0, 64, 5], (2, 3)),
        "b": [2, 6, 7, 0, 64, 5],
        "half": [1, 2.5],
        "nan": [1, 2, np.nan],
        "inf": [np.inf],
        "huge": [1e300],
        "long": np.array([3, 2**63], np.uint64),
        "bool": [True],
        "cube": np.ones((1, 1, 1)),
        "none": np.ones(0),
    }
    for name, array in values.items():
        np.save(name, array)
    np.array([2, 6, 7, 0, 64 + (9 << 16), 5], "<u4").tofile("c.label")


def codes_of_columns() -> None:
    """Print the class codes of columns of all kinds."""
    labels = pa.array(["ground", "Building", None, "car", "class 40", "low vegetation"])
    columns = {
        "class": [2, None, 7, 65, 40, 3],
        "label": labels,
        "packed": labels.dictionary_encode(),
        **{kind: pa.array([2, None, 64], kind) for kind in ("uint8", "uint64", "float32")},
        "truth": [True, False],
        "nothing": pa.array([], "int64"),
        "roof": ["roof tile"],
    }
    for name, column in columns.items():
        path = Path(f"{name}.parquet")
        parquet.write_table(pa.table({name: column}), path)
        try:
            print(name, *open_codes(path, name).codes())
        except Exception as error:
            print(name, error)


def tables() -> None:
    """Write tables of records."""
    columns = {"line": [1, 1, 2, 2], "name": list("abcd"), "range_m": [1.5, None, 2, 3]}
    parquet.write_table(pa.table({**columns, "range": [7.0, 8, 9, 10]}), "a.parquet")
    units = {"azimuth [gon]": [100.0, 200, 300], "Range_mm": [1500, None, 2]}
    parquet.write_table(pa.table(units), "b.parquet")


def frames() -> None:
    """Write a turn as dumps of more numbers, with gaps, cut to a picture, and mixed."""
    four = frame()
    number = np.arange(len(four))
    six = np.column_stack([four, number // 720, number % 720 / 1e4]).astype("<f4")
    six[:, :5].tofile("five.bin")
    six.tofile("six.bin")
    four[number % 720 < 300].tofile("picture.bin")
    np.random.default_rng(1).permutation(four).tofile("mixed.bin")
    four[::50, :3] = np.nan
    four.tofile("gaps.bin")


def dump() -> None:
    """Write records of 24 bytes in big-endian order behind a header."""
    fields = [("flags", "u1"), ("range", ">u4"), ("angle", ">f4"), ("time", ">f8")]
    records = np.zeros(12, [*fields, ("column", ">u2"), ("rest", "V5")])
    number = np.arange(12)
    records["range"] = number * 500
    records["angle"] = number % 4 * 30
    records["time"] = number * 0.25
    records["column"] = number % 4
    Path("a.raw").write_bytes(b"HEAD\n" + records.tobytes())


# ---- clouds


def packed_clouds() -> None:
    """Write the same organised cloud in every form of PCD, and packed ones that lie."""
    rng = np.random.default_rng(3)
    columns = {axis: rng.uniform(-20, 20, 520).astype("f4") for axis in "xyz"}
    columns["x"][::7] = np.nan
    columns["intensity"] = rng.integers(0, 900, 520).astype("u2")
    for form in ("ascii", "binary", "binary_compressed"):
        Path(f"{form}.pcd").write_bytes(clouds.pcd(columns, form, 13, "0 0 1 1 0 0 0"))
    whole = clouds.pcd(columns, "binary_compressed", 13)
    Path("cut.pcd").write_bytes(whole[:-9])
    head, sizes, body = whole.partition(b"compressed\n")
    Path("size.pcd").write_bytes(head + sizes + body[:4] + b"\x50" + body[5:])
    Path("plain.pcd").write_bytes(head + sizes + body[4:8] * 2 + bytes(7280))


def forms_of_ply() -> None:
    """Write the same records in every form of PLY."""
    number = np.arange(700)
    columns = {
        "GPS_time": number * 1e-5 + 54160,
        "theta": (number % 70 * 0.05 - 1.5).astype("f4"),
        "range": np.random.default_rng(4).uniform(2, 60, 700).astype("f4"),
        "ring": (number % 9).astype("u2"),
        "quality": number.astype("i2"),
    }
    for form in ("ascii", "binary_little_endian", "binary_big_endian"):
        Path(f"{form}.ply").write_bytes(clouds.ply(columns, form, ("offset Pos 1 2 0",)))


def listed_again() -> None:
    """Write shots whose returns are listed anew with every return that is added."""
    again = {
        1: [(1, 1)],
        2: [(1, 1), (1, 2), (2, 2)],
        3: [(1, 1), (1, 2), (2, 2), (1, 3), (2, 3), (3, 3)],
    }
    returns = [
        (shot * 1e-5, shot % 10 * 0.1 - 2, 5.0 + echo, echo, count)
        for shot in range(90)
        for echo, count in again[shot % 5 % 3 + 1]
    ]
    time, theta, length, echo, count = map(np.array, zip(*returns, strict=True))
    columns = {"GPS_time": time, "theta": theta.astype("f4"), "range": length.astype("f4")}
    columns |= {"num_echo": echo.astype("u1"), "nb_of_echo": count.astype("u1")}
    Path("a.ply").write_bytes(clouds.ply(columns, "binary_big_endian"))


def pulses() -> None:
    """Write folders of pulses and echoes; all but the first are odd."""
    for name in "abcdefg":
        clouds.pulse_folder(Path(name))
    counts = Path("b/pulse-uint8-n_echo.bin")
    count = np.fromfile(counts, "u1")
    theta = np.fromfile("b/pulse-float32-theta.bin", "<f4")
    empty = np.flatnonzero(count == 0)[60]
    theta[empty] = theta[empty - 1]  # a shot without return meets another one
    theta.tofile("b/pulse-float32-theta.bin")
    Path("c/pulse-uint8-n_echo.bin").unlink()
    count = count.astype("i1")
    count[7] = -1
    count.tofile("c/pulse-int8-n_echo.bin")


def codes_of_image() -> None:
    """Write an image whose class codes do not all fit a byte."""
    values = np.arange(99).reshape(9, 11) * 4
    values[0] = -1
    image = np.full((9, 11), 7.5, "f4")
    np.savez("a", range_m=image, time_s=np.arange(9.0), **{"class": values})


# ---- LAS and LAZ


def las() -> None:
    """Write every point format with odd records, and class codes for them."""
    for form in range(11):
        is_new = form in (1, 5) or form > 5
        lasfile.make_las(
            Path(f"{form}.las"),
            form,
            minor=4 if is_new else None,
            seed=form,
            vlrs=lasfile.VLRS,
            evlrs=lasfile.EVLRS if is_new else (),
            user_bytes=b"between",
            header_user_bytes=b"own",
            raw_points=True,
        )
    np.save("low", np.arange(300) * 7 % 32)
    np.save("edge", np.arange(300) % 33)
    np.save("high", np.arange(300) * 7 % 99)


def laz() -> None:
    """Write LAZ with chunks of any length, and class codes in runs."""
    rng = np.random.default_rng(7)
    for form, size in ((6, 1), (6, 7), (6, 50), (6, 50_000), (7, 50), (8, 50)):
        lasfile.make_laz(Path(f"{form}.{size}.laz"), form, 300, size, form)
    for number in range(6):
        lasfile.random_laz(Path(f"{number}.laz"), rng)
    for path in Path().glob("*.las"):
        path.unlink()
    np.save("low", np.arange(300) // 9 * 7 % 32)


def names_of_classes() -> None:
    """Write LAS files that name classes themselves; some in a way that cannot be extended."""
    spec = b"LASF_Spec"
    before = struct.pack("<B15sB15sB15s", 70, b"Rail \xe4", 65, b"car", 65, b"again")
    for name, form, data in (
        ("a.laz", 6, before),
        ("b.las", 1, struct.pack("<B15s", 64, b"Rail")),
        ("odd.las", 6, bytes(17)),
        ("full.las", 6, bytes(65520)),
    ):
        lasfile.make_las(Path(name), form, vlrs=[lasfile.vlr_bytes(spec, 0, data)])
    lasfile.make_las(Path("behind.las"), 6, evlrs=[lasfile.evlr_bytes(spec, 0, bytes(16))])


def no_text() -> None:
    """Write names and coordinate systems that are no text."""
    vlrs = [
        lasfile.vlr_bytes(b"LASF_Projection", 2112, b"PROJCS[\xe9]\0"),
        lasfile.vlr_bytes(b"M\xfcller", 77, bytes(range(256))),
    ]
    for name in ("a.las", "a.laz"):
        evlr = lasfile.evlr_bytes(b"B\xe4r", 5, b"abc")
        lasfile.make_las(Path(name), 6, vlrs=vlrs, evlrs=[evlr])


def geo_keys() -> None:
    """Write coordinate systems as GeoTIFF keys."""
    for name, keys in {
        "utm": [(3072, 32635)],
        "both": [(3072, 32635), (4096, 5773)],
        "datum": [(3072, 32635), (4096, 5103)],
        "degrees": [(2048, 4326)],
        "own": [(3072, 32767)],
        "none": [],
    }.items():
        data = struct.pack("<4H", 1, 1, 0, len(keys))
        data += b"".join(struct.pack("<4H", key, 0, 1, code) for key, code in keys)
        vlr = lasfile.vlr_bytes(b"LASF_Projection", 34735, data)
        lasfile.make_las(Path(f"{name}.las"), 1, vlrs=[vlr])


def waveforms() -> None:
    """Write waveforms behind the points, and records of several scanner channels."""
    lasfile.make_las(Path("a.las"), 4, user_bytes=b"x", raw_points=True)
    data = bytearray(Path("a.las").read_bytes())
    struct.pack_into("<Q", data, 227, len(data))
    data[6] = 2
    waves = lasfile.evlr_bytes(b"LASF_Spec", 65535, bytes(100))
    Path("a.las").write_bytes(data + waves)
    parsed = lasfile.make_las(Path("b.las"), 9, raw_points=True)
    start = lasfile.field(parsed.data, 96, "I")
    data = bytearray(parsed.data)
    data[start + 15 :: parsed.records.shape[1]] = bytes(k % 4 << 4 for k in range(300))
    Path("b.las").write_bytes(data)


def piped(source: str) -> None:
    """Write a LAZ file as programs do that cannot seek: its chunk table is told at the end."""
    data = bytearray(Path(source).read_bytes())
    start = lasfile.field(data, 96, "I")
    data += data[start : start + 8]
    data[start : start + 8] = b"\xff" * 8
    Path("a.laz").write_bytes(data)


# ---- organised scans


def ptx() -> None:
    """Write scans as PTX."""
    scan = organised.ptx_scan(organised.grid_points(4, 5, missing=0))
    for name, n_scans in (("one", 1), ("two", 2), ("four", 4)):
        Path(f"{name}.ptx").write_text(scan * n_scans)
    points = organised.grid_points(9, 7)
    turned = organised.ptx_scan(points, True, rotation=organised.turn_x(20), shift=(5, 6, 7))
    Path("turned.ptx").write_text(turned)
    moved = organised.ptx_scan(points, shift=(5, 6, 7), position=(1, 2, 3))
    bright = organised.ptx_scan(points * [1, 1, 1, 900])
    Path("moved.ptx").write_text(moved + bright + scan)


def e57() -> None:
    """Write scans as E57, whole and in no order, and none."""
    none = organised.write_e57(Path("none.e57"), [])
    others = organised.replace_xml(none.read_bytes(), b"data3D", b"others")
    Path("others.e57").write_bytes(others)
    fields = organised.e57_fields(organised.grid_points(9, 7))
    for turn in (0.0, 1.0, 1e200):
        pose = (turn, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0)
        scan = organised.Scan(fields, *pose, limits=(0.0, 2.0))
        organised.write_e57(Path(f"{turn}.e57"), [scan, scan])
    order = np.argsort(fields["rowIndex"], kind="stable")
    rows_first = organised.Scan(organised.reordered(fields, order))
    organised.write_e57(Path("sorted.e57"), [rows_first])
    again = {name: np.repeat(values, 50) for name, values in fields.items()}
    organised.write_e57(Path("again.e57"), [organised.Scan(again)])
    flat = {**again, "rowIndex": 0 * again["rowIndex"]}
    organised.write_e57(Path("flat.e57"), [organised.Scan(flat)])


def e57_lies() -> None:
    """Write scans whose fields make no image."""
    nine = np.arange(9)
    write = organised.write_odd_e57
    write("bare", rowIndex=None, columnIndex=None)
    write("rows", columnIndex=None)
    write("no-x", cartesianX=None)
    write("half", rowIndex=nine / 2)
    write("nan", rowIndex=nine * np.nan)
    write("tall", rowIndex=nine * 10**14)
    write("wide", columnIndex=nine * 10**8)
    write("thin", rowIndex=nine * 10**6, columnIndex=nine * 10**6)


def e57_angles() -> None:
    """Write scans as ranges and angles, one of them turned and one empty."""
    column, row = (index.ravel() for index in np.indices((9, 7)))
    length = 5.0 + np.arange(63)
    length[::9] = 0
    fields = {
        "sphericalRange": length,
        "sphericalAzimuth": column / 4 - 1,
        "sphericalElevation": row / 4 - 0.8,
        "columnIndex": column,
        "rowIndex": row,
    }
    organised.write_e57(Path("a.e57"), [organised.Scan(fields)])
    turned = organised.Scan(fields, (0.8, 0.6, 0.0, 0.0), (4.0, 5.0, 6.0), bounds=(0, 8, 0, 9))
    empty = organised.Scan({name: values[:0] for name, values in fields.items()})
    organised.write_e57(Path("b.e57"), [turned, empty])


# ---- captures and bags


def captures() -> None:
    """Write the same packets in every kind of capture, twice, and out of order."""
    frames_sent = packet.framed(packet.vlp16(6))
    packet.write_pcap(Path("plain.pcap"), frames_sent)
    packet.write_pcap(Path("twice.pcap"), frames_sent * 2)
    packet.write_pcap(Path("big.pcap"), frames_sent, order=">")
    packet.write_pcap(Path("nano.pcap"), frames_sent, nano=True)
    packet.write_pcapng(Path("new.pcapng"), frames_sent)
    packet.write_pcapng(Path("big.pcapng"), frames_sent, order=">")
    *first, fourth, fifth, last = frames_sent
    packet.write_pcap(Path("swapped.pcap"), [*first, fifth, fourth, last])
    simple = b"".join(
        struct.pack("<III", 3, len(data) + 16, len(data)) + data + struct.pack("<I", len(data) + 16)
        for _, data in frames_sent
    )
    head = Path("new.pcapng").read_bytes()[:92]
    Path("simple.pcapng").write_bytes(head + simple)


def makers() -> None:
    """Write packets of every Hesai with a return and with two."""
    for name in packet.HESAI:
        for kind, mode in (("single", 0x37), ("dual", 0x39)):
            sent = packet.hesai(name, 40, mode=mode)[0]
            packet.write_pcap(Path(f"{name}-{kind}.pcap"), packet.framed(sent))


def links() -> None:
    """Write the same packets as they come over every kind of link."""
    bodies = [packet.udp(body) for body in packet.vlp16(6)]
    times = [number * packet.PACKET_S for number in range(6)]
    four = list(map(packet.ip4, bodies))
    tagged = [packet.ethernet(body, vlan=True) for body in four]
    six = [packet.ethernet(packet.ip6(body)) for body in bodies]
    for name, link, sent in (
        ("tagged", 1, tagged),
        ("six", 1, six),
        ("raw", 101, four),
        ("cooked", 113, [bytes(14) + b"\x08\x00" + body for body in four]),
        ("cooked2", 276, [b"\x08\x00" + bytes(18) + body for body in four]),
        ("null", 0, [bytes(4) + body for body in four]),
        ("other", 147, four),
    ):
        packet.write_pcap(Path(f"{name}.pcap"), list(zip(times, sent, strict=True)), link=link)


def fragments() -> None:
    """Write packets of IPv6 in two fragments each, all of them and without the last one."""
    parts = []
    for number, body in enumerate(map(packet.udp, packet.vlp16(6))):
        for first, part in ((0, body[:808]), (808, body[808:])):
            head = struct.pack(">BBHI", 17, 0, first | (first == 0), number)
            whole = bytearray(packet.ip6(head + part))
            whole[6] = 44
            parts.append((number * packet.PACKET_S, packet.ethernet(bytes(whole))))
    packet.write_pcap(Path("a.pcap"), parts)
    packet.write_pcap(Path("lost.pcap"), parts[:-1])


def unknown_packets() -> None:
    """Write packets that are not read."""
    vlp = packet.vlp16(5)
    xt = packet.hesai("XT16")[0][0]
    for name, packets in {
        "vlp32": packet.vlp16(model=0x23),
        "xt16": [xt[:2] + b"\4\3" + xt[4:]],
        "hdl64": packet.velodyne(3, 0x40),
        "triple": packet.hesai("XT32M", mode=0x3D)[0],
        "modes": vlp + packet.vlp16(5, mode=0x38),
        "none": [b"hello"],
        "short": [vlp[0][:-9]],
    }.items():
        packet.write_pcap(Path(f"{name}.pcap"), packet.framed(packets))


def ouster() -> None:
    """Write a capture with the metadata beside it, and one without."""
    table, packets = packet.ouster()
    Path("a.json").write_text(json.dumps(table))
    for name in ("a", "b"):
        packet.write_pcap(Path(f"{name}.pcap"), packet.framed(packets, 7502))


def bags() -> None:
    """Write bags of laser scans, of clouds, and of both."""
    lasers = bag.lasers(2)
    bag.write_bag(Path("lasers.bag"), bag.lasers(1))
    bag.write_bag(Path("talk.bag"), bag.strings(1))
    bag.write_mcap(Path("lasers.mcap"), lasers)
    bag.write_mcap(Path("clouds.mcap"), bag.clouds(bag.drive(120)), "zstd")
    of_cloud = bag.lasers(2, "/of_cloud", "velodyne")
    bag.write_mcap(Path("mixed.mcap"), [*bag.clouds(bag.drive()), *lasers, *of_cloud])
    ranges = [[3.0, 5.0], [], [7.0], [0.01, 9.0], [200.0]]
    lit = [[1.0, 8.0], [], [2.0], [9.0, 1.0], [1.0]]
    bag.write_bag(Path("echoes.bag"), bag.echoes(1, ranges, lit, n=2))


def databases() -> None:
    """Write databases, plain and packed, of several files, and one whose messages are a view."""
    lasers = bag.lasers(2)
    bag.write_db3(Path("a.db3"), lasers)
    bag.write_db3(Path("b.db3"), lasers, packed=True)
    base = sqlite3.connect("view.db3")
    base.execute("CREATE TABLE topics(id, name, type, serialization_format)")
    base.execute("CREATE VIEW messages AS SELECT 1 AS id")
    base.close()
    Path("split").mkdir()
    for number in range(3):
        bag.write_db3(Path(f"split/rec_{number}.db3"), lasers[5 * number :][:5])


def odd_bags() -> None:
    """Write laser scans and clouds that are not read, or only up to one."""
    lasers = bag.lasers(1)
    after_ns = bag.START_NS + 40 * bag.PERIOD_NS
    for name, n_before, changes in (
        ("no-step", 0, {"angle_increment": 0.0}),
        ("no-start", 0, {"angle_min": np.nan}),
        ("no-time", 0, {"time_increment": np.inf}),
        ("wide", 12, {"angle_increment": 0.2}),
        ("back", 12, {"angle_increment": -3 / 39}),
        ("dim", 12, {"intensities": np.ones(3, "f4")}),
        ("dark", 0, {"intensities": np.ones(0, "f4")}),
    ):
        scan = bag.laser(bag.STORES[1], after_ns, bag.ranges()[0], **changes)
        odd = bag.Sent("/scan", lasers[0].kind, after_ns, scan)
        bag.write_bag(Path(f"{name}.bag"), [*lasers[:n_before], odd])
    for name, fields in {
        "plain": "x y z intensity",
        "livox": "x y z intensity tag line timestamp",
        "no-z": "x y ring t",
    }.items():
        points = np.ones(5, [(field, "f4") for field in fields.split()])
        cloud = bag.cloud(1, bag.START_NS, points)
        sent = bag.Sent("/points", bag.CLOUD, bag.START_NS, cloud)
        bag.write_bag(Path(f"{name}.bag"), [sent])
    (unknown, *_) = bag.clouds(bag.drive(100), version=1)
    unknown.message.fields[0].datatype = 99
    bag.write_bag(Path("unknown.bag"), [unknown])


def two_in_one() -> None:
    """Write clouds of two scanners each, whose points share a time by so many columns."""
    left = bag.drive(400, together=True)
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    right = {**left, "xyz": left["xyz"] @ turn}
    both = {name: np.concatenate([left[name], right[name]]) for name in left}
    kind = bag.kind_of("time", "f8")
    for n_columns in (1, 70, 100):
        both["time"] = bag.COLUMN_S * (both["column"] // n_columns * n_columns)
        sent = bag.clouds(both, kind, every=200, version=1, by_ring=False)
        bag.write_bag(Path(f"{n_columns}.bag"), sent)


def images_for_bags() -> None:
    """Write images whose angles or times no message can have."""
    ranges = np.full((6, 300), 5, "f4")
    angle = np.linspace(-1, 1, 300)
    np.savez("uneven", range_m=ranges, angle_rad=angle**3, time_s=np.arange(6.0))
    np.savez("timeless", range_m=ranges, angle_rad=angle)
    for name, time_s in (("early", -5.0), ("late", 1e12), ("nan", np.nan)):
        times = np.array([0, 1, 2, time_s, 4, 5])
        np.savez(name, range_m=ranges, angle_rad=angle, time_s=times)
