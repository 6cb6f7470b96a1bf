"""E57 files."""

from __future__ import annotations

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
from tests.formats.organised_files import Array, Scan, e57_fields, grid_points, reordered, write_e57
from tests.formats.test_ptx import equal, expected, scans_of

AUTO = InputConfig()


def refused(path: Path, config: InputConfig = AUTO) -> str:
    """The error of opening and reading, always one line, without the folder."""
    with pytest.raises(PrcError) as caught:
        scans_of(E57Stream(path, config))
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{path.parent}/", "")


def row_major(points: Array) -> Array:
    """Order of the points that are there, rows outermost."""
    there = points[..., :3].any(axis=-1)
    fields = e57_fields(points)
    order: Array = np.lexsort((fields["columnIndex"], fields["rowIndex"]))
    assert len(order) == there.sum()
    return order


def orders(points: Array) -> dict[str, Array]:
    n = int(points[..., :3].any(axis=-1).sum())
    mixed = np.random.default_rng(5).permutation(n)
    columns = e57_fields(points)["columnIndex"]
    return {
        "column by column": np.arange(n),
        "row by row": row_major(points),
        "no order": mixed,
        "rows of a column in no order": mixed[np.argsort(columns[mixed], kind="stable")],
        "backwards": np.arange(n)[::-1],
    }


def test_any_order_gives_the_same_lines(tmp_path: Path) -> None:
    points = grid_points(9, 7)
    ranges, xyz = expected(points)
    for name, order in orders(points).items():
        fields = reordered(e57_fields(points), order)
        stream = open_input(Input.of(write_e57(tmp_path / "a.E57", [Scan(fields)])), AUTO)
        (block,) = scans_of(stream)
        assert (stream.info.format, stream.info.n_lines, stream.info.points_per_line) == (
            "E57",
            9,
            7,
        )
        assert equal(block.range_m, ranges), name
        assert block.xyz_m is not None
        assert equal(block.xyz_m, xyz)
        record = np.full((9, 7), -1)
        record[fields["columnIndex"], fields["rowIndex"]] = np.arange(len(order))
        assert equal(block.record, record), name
        assert equal(
            block.intensity, np.where(np.isnan(ranges), np.nan, points[..., 3].astype(np.float32))
        )
        assert block.tally == ReadTally(n_records=len(order))
        on_disk = any("sorted on disk" in item.why for item in stream.info.assumptions)
        assert on_disk != (name in ("column by column", "rows of a column in no order"))


def test_registered_points_without_a_pose_take_the_place_of_the_scanner(tmp_path: Path) -> None:
    points = grid_points(9, 7)
    there = points[..., :3].any(axis=-1, keepdims=True)
    place = np.array([4096.0, -8192.0, 32.0, 0.0])  # no bit is lost in the sum
    points[..., :3] = np.round(points[..., :3] * 1024) / 1024
    registered = write_e57(
        tmp_path / "a.e57", [Scan(e57_fields(np.where(there, points + place, 0)))]
    )
    config = InputConfig(range="origin:4096,-8192,32")
    stream = open_input(Input.of(registered), config)
    ranges, xyz = expected(points)
    (block,) = scans_of(stream)
    assert equal(block.range_m, ranges)
    assert block.xyz_m is not None
    assert equal(block.xyz_m, xyz)
    assert stream.info.facts.stations == {0: (4096.0, -8192.0, 32.0)}
    assert "origin" not in stream.info.facts.refuses
    assert "--range origin:X,Y,Z" in open_input(Input.of(registered), AUTO).info.facts.remedy
    turned = write_e57(tmp_path / "b.e57", [Scan(e57_fields(points), (1.0, 0.0, 0.0, 0.0))])
    assert "one scan of x, y, z without a pose" in refused(turned, config)
    two = write_e57(tmp_path / "c.e57", [Scan(e57_fields(points))] * 2)
    assert "one scan of x, y, z without a pose" in refused(two, config)


@pytest.mark.parametrize("shots", [1, 20, 70])
@pytest.mark.parametrize("chunk", [3, 17])
def test_chunks_change_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    shots: int,
    chunk: int,
) -> None:
    points = grid_points(9, 7)
    more_points = grid_points(4, 12, 2)
    fields = [reordered(e57_fields(points), order) for order in orders(points).values()]
    scans = [
        Scan(item, rotation=(0.8, 0.4, 0.2, 0.4)) for item in (*fields, e57_fields(more_points))
    ]
    path = write_e57(tmp_path / "a.e57", scans)
    whole = scans_of(E57Stream(path, AUTO))
    monkeypatch.setattr("prc_cli.formats.organised.scans.CHUNK_SHOTS", shots)
    monkeypatch.setattr(e57_read, "CHUNK_POINTS", chunk)
    for block, undivided in zip(scans_of(E57Stream(path, AUTO)), whole, strict=True):
        assert equal(block.range_m, undivided.range_m)
        assert equal(block.xyz_m, undivided.xyz_m)  # type: ignore[arg-type]
        assert equal(block.record, undivided.record)  # type: ignore[arg-type]
        assert block.tally == undivided.tally


def without(*names: str, **added: Array) -> dict[str, Array]:
    fields = e57_fields(grid_points(3, 3, missing=0))
    return {**{name: values for name, values in fields.items() if name not in names}, **added}


@pytest.mark.parametrize(
    ("scan", "parts"),
    {
        "no indices": (
            Scan(without("rowIndex", "columnIndex")),
            ("scan 0", "no rowIndex and no columnIndex"),
        ),
        "no column": (Scan(without("columnIndex")), ("no columnIndex", "not organised")),
        "no coordinates": (Scan(without("cartesianX")), ("expected cartesianX",)),
        "half an index": (
            Scan(without(rowIndex=np.arange(9) / 2)),
            ("rowIndex from 0 to 4", "whole numbers"),
        ),
        "no index": (
            Scan(without(rowIndex=np.full(9, np.nan))),
            ("rowIndex from nan", "whole numbers"),
        ),
        "huge rows": (
            Scan(without(rowIndex=np.arange(9) * 10**14)),
            ("rowIndex from 0 to 8", "at most 10000000"),
        ),
        "huge columns": (
            Scan(without(columnIndex=np.arange(9) * 10**8)),
            ("columnIndex from 0 to 8", "at most"),
        ),
        "huge scan": (
            Scan(without(columnIndex=np.arange(9) * 10**6, rowIndex=np.arange(9) * 10**6)),
            ("found 9 points in 8000001 columns x 8000001 rows", "denser"),
        ),
        "crowded cells": (
            Scan(
                {
                    name: np.repeat(values, 50)[:430]
                    for name, values in without(rowIndex=np.zeros(9, int)).items()
                }
            ),
            ("found 150 points in column 0", "1 rows"),
        ),
        "no rotation": (Scan(without(), rotation=(0, 0, 0, 0)), ("scan 0", "quaternion")),
        "rotation too long": (Scan(without(), rotation=(1e200, 0, 0, 0)), ("quaternion",)),
    }.values(),
)
def test_scans_that_are_no_images_are_refused(
    tmp_path: Path, scan: Scan, parts: tuple[str, ...]
) -> None:
    message = refused(write_e57(tmp_path / "a.e57", [scan]))
    for part in parts:
        assert part in message


def test_a_file_that_changes_while_it_is_read_is_an_error(tmp_path: Path) -> None:
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
