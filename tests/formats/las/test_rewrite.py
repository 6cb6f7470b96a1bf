"""LAS and LAZ, rewritten and new.

Only the class and requested dimensions change; a record for every return.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from laspy.vlrs.known import ClassificationLookupVlr

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import InputError, OutputError
from prc_cli.core.stream import LabelledBlock
from prc_cli.formats.las.header import standard_bytes
from prc_cli.formats.las.points import set_classes
from prc_cli.formats.las.vlrs import names_of_file
from prc_cli.formats.writing.columns import OutputConfig
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


@pytest.mark.parametrize(("before", "after"), [(".las", ".laz"), (".laz", ".las")])
@pytest.mark.parametrize("form", range(11))
def test_only_the_class_changes(
    tmp_path: Path,
    form: int,
    before: str,
    after: str,
) -> None:
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
def test_codes_above_31_upgrade_the_format(tmp_path: Path, form: int, suffix: str) -> None:
    source = tmp_path / "in.las"
    output = tmp_path / f"out{suffix}"
    old = make_las(
        source, form, raw_points=True, vlrs=VLRS[1:], user_bytes=b"user", header_user_bytes=b"mine"
    )
    labels = random_labels(300, FOREST)
    with writer(output, source) as opened:
        for block in record_blocks(labels):
            opened.add(block)
        opened.finish(run_record())
    assert any(
        f"point format {form} cannot hold code 64; upgraded to {UPGRADED[form]}" in text
        for text in opened.notices
    )
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
    _same_dimensions(source, output, form)


def _same_dimensions(source: Path, output: Path, form: int) -> None:
    old = laspy.read(source)
    new = laspy.read(output)
    for name in old.point_format.dimension_names:
        if name in ("classification", "scan_angle_rank"):
            continue
        assert np.asarray(old[name]).tobytes() == np.asarray(new[name]).tobytes(), name
    ranks = np.asarray(old["scan_angle_rank"]).astype(float)
    assert np.abs(np.asarray(new["scan_angle"]) * 0.006 - ranks).max() <= 0.003 + 1e-9


# ---- extra bytes


def test_an_extra_dimension_of_another_type_is_refused(tmp_path: Path) -> None:
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


# ---- odd and damaged files


@pytest.mark.parametrize("after", [".las", ".laz"])
def test_waveforms_of_several_channels_are_not_spoilt(tmp_path: Path, after: str) -> None:
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


def test_a_changed_input_is_noticed(tmp_path: Path) -> None:
    source = tmp_path / "in.las"
    make_las(source, 6)
    with writer(tmp_path / "out.las", source) as opened:
        make_las(source, 6, n=301)
        with pytest.raises(InputError, match="found another header than at the start of the run"):
            opened.finish(run_record())


def test_a_record_too_long_for_a_vlr_is_shortened_there_only(tmp_path: Path) -> None:
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
def test_five_bits_hold_code_31_and_not_32(form: int) -> None:
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
    lookups = [
        vlr for vlr in laspy.read(path).header.vlrs if isinstance(vlr, ClassificationLookupVlr)
    ]
    assert len(lookups) <= 1
    return dict(lookups[0].lookups) if lookups else {}


def stems(n: int = N) -> list[LabelledBlock]:
    labels = np.full((n // 20, 20), Label.STEM, np.uint8)
    return [labelled(labels)]


def named(path: Path, data: bytes) -> Path:
    """A LAS file that names classes itself."""
    las = laspy.create(point_format=6, file_version="1.4")
    las.x = np.arange(N)
    las.header.vlrs.append(laspy.VLR("LASF_Spec", 0, "of the makers", data))
    las.write(path)
    return path


@pytest.mark.parametrize("form", [1, 6])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_copies_hold_them_and_all_else_stays(tmp_path: Path, form: int, suffix: str) -> None:
    make_las(tmp_path / f"in{suffix}", form)
    write(tmp_path / f"out{suffix}", tmp_path / f"in{suffix}", stems(), user_names=NAMES)
    write(tmp_path / f"plain{suffix}", tmp_path / f"in{suffix}", stems(), user_names={})
    assert entries(tmp_path / f"out{suffix}") == NAMES
    out = parse(tmp_path / f"out{suffix}")
    plain = parse(tmp_path / f"plain{suffix}")
    ours = [vlr for vlr in out.vlrs if vlr[2:].startswith(b"LASF_Spec\0") and vlr[18:20] == b"\0\0"]
    assert len(ours) == 1
    assert ours[0][54:] == b"".join(
        struct.pack("<B15s", code, name.encode()) for code, name in NAMES.items()
    )
    assert [vlr for vlr in out.kept_vlrs() if vlr not in ours] == plain.kept_vlrs()
    assert out.records.tobytes() == plain.records.tobytes()


def test_names_of_the_input_are_kept_and_joined(tmp_path: Path) -> None:
    before = struct.pack("<B15sB15sB15s", 70, b"Rail \xe4", 65, b"car", 65, b"again")
    source = named(tmp_path / "in.laz", before)
    record = write(tmp_path / "out.laz", source, stems(), user_names=NAMES)
    after = next(
        vlr
        for vlr in parse(tmp_path / "out.laz").vlrs
        if vlr[18:20] == b"\0\0" and b"LASF_Spec" in vlr[:20]
    )
    assert after[54:] == before + struct.pack("<B15s", 64, b"stem")
    assert after[22:54].startswith(b"of the makers")
    assert not [notice for notice in record.notices if "named" in notice]
    assert names_of_file(tmp_path / "out.laz")[64] == "stem"
    # what names them all already stays as it is
    write(tmp_path / "again.laz", tmp_path / "out.laz", stems(), user_names=NAMES)
    assert parse(tmp_path / "again.laz").kept_vlrs() == parse(tmp_path / "out.laz").kept_vlrs()


def test_another_name_gives_way_and_is_told(tmp_path: Path) -> None:
    source = named(tmp_path / "in.las", struct.pack("<B15s", 64, b"Rail"))
    record = write(tmp_path / "out.las", source, stems(), user_names=NAMES)
    assert entries(tmp_path / "out.las") == NAMES
    assert "class 64 was named 'Rail' in the input; its name is now 'stem'" in record.notices


SOURCE = Path("drive.bin")
LINES = 12
M = 30


def stream(seed: int = 0, **fields: Any) -> tuple[list[LabelledBlock], np.ndarray, np.ndarray]:
    """Blocks of five lines (the last shorter), their ranges and labels."""
    rng = np.random.default_rng(seed)
    ranges = (rng.random((LINES, M)) * 80 + 0.1).astype(np.float32)
    ranges[rng.random((LINES, M)) < 0.3] = np.nan
    labels = random_labels(LINES * M, FOREST).reshape(LINES, M)
    labels[np.isnan(ranges)] = Label.MISSING
    blocks = []
    for first in range(0, LINES, 5):
        rows = slice(first, first + 5)
        values = {
            name: value if name in ("angle_rad", "scanner") else value[rows]
            for name, value in fields.items()
        }
        blocks.append(labelled(labels[rows], first_line=first, range_m=ranges[rows], **values))
    return blocks, ranges, labels


def test_xyz_time_intensity_and_scanner(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    xyz = rng.normal(0, 50, (LINES, M, 3)).astype(np.float32)
    time = rng.random((LINES, M)) * 1e9
    time[0, :] = np.nan
    intensity = rng.random((LINES, M)).astype(np.float32) * 80_000 - 100
    blocks, ranges, _ = stream(xyz_m=xyz, time_s=time, intensity=intensity, scanner=3)
    record = write(tmp_path / "a.laz", SOURCE, blocks)
    las = laspy.read(tmp_path / "a.laz")
    has_return = np.nonzero(~np.isnan(ranges))
    assert np.allclose(las.xyz, xyz[has_return], atol=0.00051)
    assert np.array_equal(las.gps_time, np.nan_to_num(time[has_return]))
    assert np.array_equal(las.intensity, np.clip(np.rint(intensity[has_return]), 0, 65535))
    assert np.all(las.point_source_id == 3)
    n_first = np.count_nonzero(has_return[0] == 0)
    assert f"{n_first} records have no time; their gps_time is 0" in record.notices
    assert any(
        "intensities lie outside 0 to 65535 and were clipped" in text for text in record.notices
    )


@pytest.mark.parametrize(
    ("before", "after"), [(".las", ".laz"), (".laz", ".laz"), (".las", ".las")]
)
def test_texts_that_are_none_are_written_so_that_others_can_read_the_file(
    tmp_path: Path, before: str, after: str
) -> None:
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
