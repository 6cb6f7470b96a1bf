"""LAS and LAZ, rewritten and new.

Only the class and requested dimensions change; a record for every return.
"""

import json
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import InputError
from prc_cli.formats.las.header import standard_bytes
from prc_cli.formats.las.points import set_classes
from prc_cli.formats.writing.columns import OutputConfig
from tests.formats.common import (
    FOREST,
    labelled,
    random_labels,
    record_blocks,
    run_record,
    write,
    writer,
)
from tests.formats.las.lasbytes import (
    EVLRS,
    VLRS,
    classes,
    field,
    make_las,
    parse,
    same_but_class,
)


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
    labels = random_labels(300)
    write(output, source, record_blocks(labels))
    new = parse(output)
    same_but_class(old, new)
    assert np.array_equal(classes(new), ClassCodes().lookup()[labels])
    assert len(new.record_payloads()) == 1
    assert bool(new.header[104] & 0x80) == (after == ".laz")
    if minor == 4:
        assert field(new.data, 235, "Q") == len(new.data) - len(new.tail)
        assert field(new.data, 243, "I") == 2


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


@pytest.mark.parametrize("form", range(6))
def test_five_bits_hold_code_31_and_not_32(form):
    records = np.full((2, standard_bytes(form)), 0xFF, np.uint8)
    set_classes(records, form, np.array([31, 0], np.uint8))
    assert records[:, 15].tolist() == [0xFF, 0xE0]
    with pytest.raises(
        ValueError, match=rf"code 32 does not fit the five bits of point format {form}"
    ):
        set_classes(records, form, np.array([2, 32], np.uint8))


UPGRADED = {0: 6, 1: 6, 2: 7, 3: 7, 4: 9, 5: 10}


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("form", range(9))
def test_codes_above_31_and_segments_leave_every_field_as_laspy_reads_it(tmp_path, form, suffix):
    source = tmp_path / "in.las"
    output = tmp_path / f"out{suffix}"
    make_las(source, form, raw_points=True)
    labels = random_labels(300, FOREST)
    segments = np.arange(300) ** 2
    blocks = record_blocks(labels, segments=segments)
    write(output, source, blocks, options=OutputConfig(segment_ids=True))
    old = laspy.read(source)
    new = laspy.read(output)
    assert new.point_format.id == UPGRADED.get(form, form)
    np.testing.assert_array_equal(new.classification, ClassCodes().lookup()[labels])
    np.testing.assert_array_equal(new["segment_id"], segments)
    for name in set(old.point_format.dimension_names) - {"classification", "scan_angle_rank"}:
        assert np.asarray(old[name]).tobytes() == np.asarray(new[name]).tobytes(), name
    if form < 6:
        ranks = np.asarray(old["scan_angle_rank"])
        np.testing.assert_allclose(np.asarray(new["scan_angle"]) * 0.006, ranks, atol=0.0031)
        returns = np.bincount(old.return_number, minlength=16)[1:]
        np.testing.assert_array_equal(new.header.number_of_points_by_return, returns)


def test_a_new_file_has_place_time_intensity_and_scanner(tmp_path):
    rng = np.random.default_rng(4)
    labels = random_labels(360, (0, 2)).reshape(12, 30)
    seen = labels > 0
    xyz = rng.normal(0, 50, (12, 30, 3)).astype(np.float32)
    time = np.where(np.arange(12)[:, None] == 0, np.nan, rng.random((12, 30)) * 1e9)
    lit = rng.uniform(-100, 70_000, (12, 30)).astype(np.float32)
    block = labelled(labels, xyz_m=xyz, time_s=time, intensity=lit, scanner=3)
    write(tmp_path / "a.laz", Path("drive.bin"), [block])
    las = laspy.read(tmp_path / "a.laz")
    np.testing.assert_allclose(las.xyz, xyz[seen], atol=0.00051)
    np.testing.assert_array_equal(las.gps_time, np.nan_to_num(time[seen]))
    np.testing.assert_array_equal(las.intensity, np.rint(np.clip(lit[seen], 0, 65535)))
    assert set(las.point_source_id) == {3}
