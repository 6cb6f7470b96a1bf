"""E57 files."""

from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import PrcError
from prc_cli.core.stream import ReadTally
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised import e57_read
from prc_cli.formats.organised.e57_read import E57Stream
from prc_cli.streams.open import open_input
from tests.formats.organised_files import (
    Array,
    Scan,
    e57_fields,
    grid_points,
    write_e57,
)
from tests.formats.test_ptx import equal, expected, scans_of

AUTO = InputConfig()


def refused(path: Path, config: InputConfig = AUTO) -> str:
    """The error of opening and reading, always one line, without the folder."""
    with pytest.raises(PrcError) as caught:
        scans_of(E57Stream(path, config))
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{path.parent}/", "")


ORDERS = ("column by column", "row by row", "no order", "rows in no order", "backwards")


def ordered_fields(points: Array, name: str) -> dict[str, Array]:
    """The points of a grid in another order."""
    fields = e57_fields(points)
    n = len(fields["rowIndex"])
    mixed = np.random.default_rng(5).permutation(n)
    order = {
        "column by column": np.arange(n),
        "row by row": np.lexsort((fields["columnIndex"], fields["rowIndex"])),
        "no order": mixed,
        "rows in no order": mixed[np.argsort(fields["columnIndex"][mixed], kind="stable")],
        "backwards": np.arange(n)[::-1],
    }[name]
    return {field: values[order] for field, values in fields.items()}


@pytest.mark.parametrize("name", ORDERS)
def test_any_order_gives_the_same_lines(tmp_path, name):
    points = grid_points(9, 7)
    ranges, xyz = expected(points)
    fields = ordered_fields(points, name)
    stream = open_input(Input.of(write_e57(tmp_path / "a.E57", [Scan(fields)])), AUTO)
    (block,) = scans_of(stream)
    info = stream.info
    assert (info.format, info.n_lines, info.points_per_line) == ("E57", 9, 7)
    assert equal(block.range_m, ranges)
    assert equal(block.xyz_m, xyz)
    n = len(fields["rowIndex"])
    record = np.full((9, 7), -1)
    record[fields["columnIndex"], fields["rowIndex"]] = np.arange(n)
    assert equal(block.record, record)
    intensity = points[..., 3].astype(np.float32)
    assert equal(block.intensity, np.where(np.isnan(ranges), np.nan, intensity))
    assert block.tally == ReadTally(n_records=n)
    on_disk = any("sorted on disk" in item.why for item in info.assumptions)
    assert on_disk != (name in ("column by column", "rows in no order"))


def test_registered_points_without_a_pose_take_the_place_of_the_scanner(tmp_path):
    points = grid_points(9, 7)
    place = np.array([4096.0, -8192.0, 32.0])  # no bit is lost in the sum
    points[..., :3] = np.round(points[..., :3] * 1024) / 1024
    fields = e57_fields(points)
    names = ("cartesianX", "cartesianY", "cartesianZ")
    moved = {name: fields[name] + by for name, by in zip(names, place, strict=True)}
    path = write_e57(tmp_path / "a.e57", [Scan(fields | moved)])
    config = InputConfig(range="origin:4096,-8192,32")
    stream = open_input(Input.of(path), config)
    ranges, xyz = expected(points)
    (block,) = scans_of(stream)
    assert equal(block.range_m, ranges)
    assert equal(block.xyz_m, xyz)
    assert stream.info.facts.stations == {0: tuple(place)}
    assert "origin" not in stream.info.facts.refuses
    assert "--range origin:X,Y,Z" in open_input(Input.of(path), AUTO).info.facts.remedy
    for scans in ([Scan(fields, (1.0, 0.0, 0.0, 0.0))], [Scan(fields)] * 2):
        write_e57(path, scans)
        assert "one scan of x, y, z without a pose" in refused(path, config)


@pytest.mark.parametrize("shots, chunk", [(1, 3), (20, 17), (70, 3)])
def test_chunks_change_nothing(tmp_path, monkeypatch, shots, chunk):
    points = grid_points(9, 7)
    fields = [*(ordered_fields(points, name) for name in ORDERS), e57_fields(grid_points(4, 12, 2))]
    scans = [Scan(item, rotation=(0.8, 0.4, 0.2, 0.4)) for item in fields]
    path = write_e57(tmp_path / "a.e57", scans)
    whole = scans_of(E57Stream(path, AUTO))
    monkeypatch.setattr("prc_cli.formats.organised.scans.CHUNK_SHOTS", shots)
    monkeypatch.setattr(e57_read, "CHUNK_POINTS", chunk)
    for block, undivided in zip(scans_of(E57Stream(path, AUTO)), whole, strict=True):
        assert equal(block.range_m, undivided.range_m)
        assert equal(block.xyz_m, np.asarray(undivided.xyz_m))
        assert equal(block.record, np.asarray(undivided.record))
        assert block.tally == undivided.tally


def test_a_file_that_changes_while_it_is_read_is_an_error(tmp_path):
    path = write_e57(tmp_path / "a.e57", [Scan(e57_fields(grid_points(5, 4, missing=0)))])
    stream = E57Stream(path, AUTO)
    for changed in (
        grid_points(5, 9, missing=0),
        grid_points(2, 2, missing=0),
        grid_points(4, 5, missing=0),
    ):
        write_e57(path, [Scan(e57_fields(changed))])
        with pytest.raises(PrcError):
            scans_of(stream)
