"""LAS and LAZ, rewritten and new.

Only the class and requested dimensions change; a record for every return.
"""

import json
import struct
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import InputError, OutputError
from prc_cli.formats.las.header import standard_bytes
from prc_cli.formats.las.points import set_classes, upgrade
from prc_cli.formats.las.vlrs import names_of_file
from prc_cli.formats.writing.columns import Coordinates, OutputConfig
from tests.formats.common import (
    FOREST,
    URBAN,
    labelled,
    random_labels,
    record_blocks,
    run_record,
    write,
    writer,
)
from tests.formats.las.lasbytes import (
    EXTRA,
    Parsed,
    classes,
    evlr_bytes,
    field,
    make_las,
    n_points,
    parse,
    same_but_class,
    vlr_bytes,
)

VLRS = (
    vlr_bytes(b"LASF_Projection", 2112, b'PROJCS["x"]\0'),
    vlr_bytes(b"nobody\0dirt", 77, bytes(range(256))),
)
EVLRS = (evlr_bytes(b"nobody", 5, b"abc" * 50), evlr_bytes(b"LASF_Spec", 65535, bytes(1000)))
UPGRADED = {0: 6, 1: 6, 2: 7, 3: 7, 4: 9, 5: 10}


def rewrite(
    source: Path, output: Path, *, of: tuple[Label, ...] = URBAN, **changes: Any
) -> tuple[Parsed, np.ndarray]:
    n = n_points(source.read_bytes())
    labels = random_labels(n, of)
    write(output, source, record_blocks(labels), **changes)
    return parse(output), ClassCodes().lookup()[labels]


@pytest.mark.parametrize("before, after", [(".las", ".laz"), (".laz", ".las")])
@pytest.mark.parametrize("form", range(11))
def test_only_the_class_changes(
    tmp_path,
    form,
    before,
    after,
):
    source = tmp_path / f"in{before}"
    output = tmp_path / f"out{after}"
    minor = 4 if form in (1, 5, 6, 7, 8, 9, 10) else None
    old = make_las(
        source,
        form,
        minor=minor,
        seed=form,
        vlrs=VLRS,
        evlrs=EVLRS if minor == 4 else (),
        user_bytes=b"between VLRs and points",
        header_user_bytes=b"own header bytes",
        raw_points=True,
    )
    new, codes = rewrite(source, output)
    same_but_class(old, new)
    assert np.array_equal(classes(new), codes)
    assert len(new.record_payloads()) == 1
    assert bool(new.header[104] & 0x80) == (after == ".laz")
    if minor == 4:
        assert field(new.data, 235, "Q") == len(new.data) - len(new.tail)
        assert field(new.data, 243, "I") == 2


# ---- codes above 31


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("form", range(6))
def test_codes_above_31_upgrade_the_format(tmp_path, form, suffix):
    source = tmp_path / "in.las"
    output = tmp_path / f"out{suffix}"
    old = make_las(
        source, form, raw_points=True, vlrs=VLRS[1:], user_bytes=b"user", header_user_bytes=b"mine"
    )
    labels = random_labels(300, FOREST)
    record = write(output, source, record_blocks(labels))
    notice = f"point format {form} cannot hold code 64; upgraded to {UPGRADED[form]}"
    assert any(notice in text for text in record.notices)
    new = parse(output)
    assert np.array_equal(classes(new), ClassCodes().lookup()[labels])
    assert new.form == UPGRADED[form]
    assert new.data[24:26] == b"\x01\x04"
    assert field(new.data, 94, "H") == 379
    assert new.header[375:] == b"mine"
    assert new.user_bytes == b"user"
    assert field(new.data, 6, "H") & 16  # WKT
    assert struct.unpack_from("<6I", new.data, 107) == (0,) * 6
    assert new.header[131:227] == old.header[131:227]
    returns = np.bincount(old.records[:, 14] & 7, minlength=16)[1:16]
    assert struct.unpack_from("<15Q", new.data, 255) == tuple(returns)
    _same_dimensions(source, output)
    upgraded = upgrade(old.records, form)
    np.testing.assert_array_equal(upgraded[:, 16], old.records[:, 15] & 31)


def _same_dimensions(source: Path, output: Path) -> None:
    old = laspy.read(source)
    new = laspy.read(output)
    for name in set(old.point_format.dimension_names) - {"classification", "scan_angle_rank"}:
        assert np.asarray(old[name]).tobytes() == np.asarray(new[name]).tobytes(), name
    ranks = np.asarray(old["scan_angle_rank"]).astype(float)
    assert np.abs(np.asarray(new["scan_angle"]) * 0.006 - ranks).max() <= 0.003 + 1e-9


# ---- extra bytes


def test_an_extra_dimension_of_another_type_is_refused(tmp_path):
    source = tmp_path / "in.las"
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("segment_id", "u2"))
    laspy.LasData(header).write(source)
    with (
        writer(tmp_path / "out.las", source, options=OutputConfig(segment_ids=True)) as opened,
        pytest.raises(
            OutputError,
            match=r"extra bytes named 'segment_id' of type 3, expected none or type 5; .*false",
        ),
    ):
        opened.finish(run_record())


@pytest.mark.parametrize("extra", [(), EXTRA])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_segments_are_added_behind_what_is_there(tmp_path, suffix, extra):
    source = tmp_path / f"in{suffix}"
    make_las(source, 6, extra=extra)
    segments = np.random.default_rng(2).integers(0, 1 << 20, 300)
    blocks = record_blocks(random_labels(300), segments=segments)
    write(tmp_path / "out.laz", source, blocks, options=OutputConfig(segment_ids=True))
    old = laspy.read(source)
    new = laspy.read(tmp_path / "out.laz")
    np.testing.assert_array_equal(new["segment_id"], segments)
    for name in set(old.point_format.dimension_names) - {"classification"}:
        np.testing.assert_array_equal(new[name], old[name])


# ---- odd and damaged files


@pytest.mark.parametrize("after", [".las", ".laz"])
def test_waveforms_of_several_channels_are_not_spoilt(tmp_path, after):
    """laszip's third version mixes up waveform packets of several scanner channels."""
    source = tmp_path / "in.las"
    output = tmp_path / f"out{after}"
    old = make_las(source, 9, raw_points=True)
    start = field(old.data, 96, "I")
    data = bytearray(old.data)
    data[start + 15 :: old.records.shape[1]] = bytes((i % 4) << 4 for i in range(300))
    source.write_bytes(data[: len(old.data)])
    if after == ".las":
        same_but_class(parse(source), rewrite(source, output)[0])
        return
    with pytest.raises(OutputError, match=r"changes the waveform packets.*write \.las instead"):
        rewrite(source, output)
    assert list(tmp_path.iterdir()) == [source]


def test_a_changed_input_is_noticed(tmp_path):
    source = tmp_path / "in.las"
    make_las(source, 6)
    with writer(tmp_path / "out.las", source) as opened:
        make_las(source, 6, n=301)
        with pytest.raises(InputError, match="found another header than at the start of the run"):
            opened.finish(run_record())


def test_a_record_too_long_for_a_vlr_is_shortened_there_only(tmp_path):
    source = tmp_path / "in.las"
    output = tmp_path / "out.las"
    make_las(source, 6)
    record = run_record(config={"key": "x" * 70_000})
    write(output, source, record_blocks(random_labels(300)), record)
    inside = json.loads(parse(output).record_payloads()[0])
    assert inside["complete"] is False
    assert len(inside["config_sha256"]) == 64
    assert json.loads((tmp_path / "out.las.prc.json").read_text())["config"]["key"] == "x" * 70_000


# ---- real files


@pytest.mark.parametrize("form", range(6))
def test_five_bits_hold_code_31_and_not_32(form):
    records = np.full((2, standard_bytes(form)), 0xFF, np.uint8)
    set_classes(records, form, np.array([31, 0], np.uint8))
    assert records[:, 15].tolist() == [0xFF, 0xE0]
    with pytest.raises(
        ValueError, match=rf"code 32 does not fit the five bits of point format {form}"
    ):
        set_classes(records, form, np.array([2, 32], np.uint8))


N = 300
NAMES = {64: "stem", 65: "car"}


def entries(path: Path) -> dict[int, str]:
    """The names as laspy reads them."""
    lookups = laspy.read(path).header.vlrs.get("ClassificationLookupVlr")
    assert len(lookups) <= 1
    return dict(lookups[0].lookups) if lookups else {}


def names_vlr(path: Path) -> bytes:
    """The record of the names."""
    (vlr,) = [vlr for vlr in parse(path).vlrs if vlr[2:20] == b"LASF_Spec".ljust(18, b"\0")]
    return vlr


STEMS = [labelled(np.full((N // 20, 20), Label.STEM, np.uint8))]


def named(path: Path, data: bytes) -> Path:
    """A LAS file that names classes itself."""
    make_las(path, 6, vlrs=(vlr_bytes(b"LASF_Spec", 0, data),))
    return path


@pytest.mark.parametrize("form", [1, 6])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_copies_hold_them_and_all_else_stays(tmp_path, form, suffix):
    source = tmp_path / f"in{suffix}"
    out = tmp_path / f"out{suffix}"
    make_las(source, form)
    write(out, source, STEMS, user_names=NAMES)
    write(tmp_path / f"plain{suffix}", source, STEMS, user_names={})
    assert entries(out) == NAMES
    plain = parse(tmp_path / f"plain{suffix}")
    assert [vlr for vlr in parse(out).kept_vlrs() if vlr != names_vlr(out)] == plain.kept_vlrs()
    assert parse(out).records.tobytes() == plain.records.tobytes()


def test_names_of_the_input_are_kept_and_joined(tmp_path):
    before = struct.pack("<B15sB15sB15s", 70, b"Rail \xe4", 65, b"car", 65, b"again")
    out = tmp_path / "out.laz"
    record = write(out, named(tmp_path / "in.laz", before), STEMS, user_names=NAMES)
    assert names_vlr(out)[54:] == before + struct.pack("<B15s", 64, b"stem")
    assert names_vlr(out)[22:54].startswith(b"kept as it is")
    assert not [notice for notice in record.notices if "named" in notice]
    assert names_of_file(out)[64] == "stem"
    # what names them all already stays as it is
    write(tmp_path / "again.laz", out, STEMS, user_names=NAMES)
    assert parse(tmp_path / "again.laz").kept_vlrs() == parse(out).kept_vlrs()


def test_another_name_gives_way_and_is_told(tmp_path):
    source = named(tmp_path / "in.las", struct.pack("<B15s", 64, b"Rail"))
    record = write(tmp_path / "out.las", source, STEMS, user_names=NAMES)
    assert entries(tmp_path / "out.las") == NAMES
    assert "class 64 was named 'Rail' in the input; its name is now 'stem'" in record.notices


def test_xyz_time_intensity_and_scanner(tmp_path):
    rng = np.random.default_rng(4)
    shape = (12, 30)
    ranges = rng.uniform(0.1, 80, shape).astype(np.float32)
    ranges[rng.random(shape) < 0.3] = np.nan
    has_return = np.isfinite(ranges)
    labels = np.where(has_return, Label.GROUND, Label.MISSING).astype(np.uint8)
    xyz = rng.normal(0, 50, (*shape, 3)).astype(np.float32)
    time = rng.random(shape) * 1e9
    time[0, :] = np.nan
    intensity = (rng.random(shape) * 80_000 - 100).astype(np.float32)
    blocks = [
        labelled(
            labels[rows],
            first_line=rows.start,
            range_m=ranges[rows],
            xyz_m=xyz[rows],
            time_s=time[rows],
            intensity=intensity[rows],
            scanner=3,
        )
        for rows in (slice(0, 5), slice(5, 10), slice(10, 12))
    ]
    record = write(tmp_path / "a.laz", Path("drive.bin"), blocks)
    las = laspy.read(tmp_path / "a.laz")
    assert np.allclose(las.xyz, xyz[has_return], atol=0.00051)
    assert np.array_equal(las.gps_time, np.nan_to_num(time[has_return]))
    assert np.array_equal(las.intensity, np.clip(np.rint(intensity[has_return]), 0, 65535))
    assert np.all(las.point_source_id == 3)
    assert f"{has_return[0].sum()} records have no time; their gps_time is 0" in record.notices
    clipped = "intensities lie outside 0 to 65535 and were clipped"
    assert any(clipped in text for text in record.notices)


@pytest.mark.parametrize("before, after", [(".las", ".laz"), (".laz", ".laz"), (".las", ".las")])
def test_texts_that_are_none_are_written_so_that_others_can_read_the_file(tmp_path, before, after):
    source = tmp_path / f"in{before}"
    output = tmp_path / f"out{after}"
    vlrs = (
        vlr_bytes(b"LASF_Projection", 2112, b"PROJCS[\xe9]\0"),
        vlr_bytes(b"M\xfcller", 77, bytes(range(256))),
    )
    old = make_las(source, 6, minor=4, vlrs=vlrs, evlrs=(evlr_bytes(b"B\xe4r", 5, b"abc"),))
    with pytest.raises(UnicodeDecodeError), laspy.open(source):
        pass
    new, codes = rewrite(source, output)
    with laspy.open(output) as reader:
        assert len(reader.read().points) == len(codes)
        assert {vlr.user_id for vlr in reader.header.evlrs} == {"B?r"}
    assert [len(vlr) for vlr in new.kept_vlrs()] == [len(vlr) for vlr in old.kept_vlrs()]
    assert new.kept_vlrs()[1][54:] == bytes(range(256))
    assert any(
        "were written as ?" in notice for notice in json.loads(new.record_payloads()[0])["notices"]
    )


def test_lines_without_coordinates_lie_apart_and_it_is_told(tmp_path):
    record = write(tmp_path / "a.las", Path("drive.bin"), STEMS)
    start = "the input has no coordinates; nor angles: scan planes lie flat"
    assert any(notice.startswith(start) for notice in record.notices)
    assert len(np.unique(laspy.read(tmp_path / "a.las").z)) == N // 20


def test_degrees_are_written_in_fine_steps(tmp_path):
    degrees = np.random.default_rng(1).uniform((25, 60, 0), (25.001, 60.001, 9), (N // 20, 20, 3))
    places = Coordinates(degrees, np.empty((0, 3)))
    record = write(tmp_path / "a.las", Path("drive.bin"), STEMS, place=lambda _: places)
    written = laspy.read(tmp_path / "a.las").xyz
    assert np.all(np.abs(written - degrees.reshape(-1, 3)) < (1e-7, 1e-7, 1e-3))
    assert any(notice.startswith("x and y are degrees") for notice in record.notices)
