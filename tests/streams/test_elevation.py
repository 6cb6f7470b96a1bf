"""Lines by elevation: where they end, errors, and independence of chunks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from prc_cli.streams.rules import with_elevation
from tests.streams.record_lists import MemorySource

RULES = {"lines": "elevation:20", "columns": "order", "range": "sensor-xyz"}


def points(elevation_deg: Any, length: float = 5.0) -> dict[str, Any]:
    angle = np.deg2rad(np.asarray(elevation_deg, float))
    return {"x": length * np.cos(angle), "y": np.zeros(len(angle)), "z": length * np.sin(angle)}


def write(path: Path, columns: dict[str, Any]) -> Path:
    rows = zip(*(columns[name] for name in "xyz"), strict=True)
    path.write_text("x,y,z\n" + "".join(",".join(repr(float(value)) for value in row) + "\n" for row in rows))
    return path


def whole(path: Path, **rules: Any) -> ScanBlock:
    return join(list(open_input(path, InputConfig(**{**RULES, **rules})).blocks()))


@pytest.mark.parametrize("chunk", [1, 2, 7])
def test_chunks_change_nothing_and_points_without_elevation_stay(chunk: int) -> None:
    rng = np.random.default_rng(3)
    given = points(np.concatenate([np.sort(rng.uniform(-40, 80, 9)) for _ in range(12)]))
    for name in "xyz":
        given[name][[0, 20, 47]] = (0.0, 0.0, np.nan)
    rules = InputConfig(**RULES)

    def lines(size: int) -> np.ndarray[Any, Any]:
        source, changed, _ = with_elevation(MemorySource(given, chunk_records=size), rules)
        name = changed.lines.partition(":")[2]
        return np.concatenate([part.values[name] for part in source.chunks((name, "angle"))])

    one = lines(1000)
    assert one.max() == 11
    assert np.array_equal(one[20], one[19])
    assert np.array_equal(lines(chunk), one)


def test_what_cannot_have_lines_by_elevation_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", points([-30, 0]))
    with pytest.raises(ConfigError, match=r"elevation:DEG with 0 < \|DEG\| < 180"):
        whole(path, lines="elevation:0")
    with pytest.raises(ConfigError, match="expected sensor-xyz"):
        whole(path, range="origin:0,0,0")
    ranges = tmp_path / "r.csv"
    ranges.write_text("range,column\n1,0\n2,1\n")
    with pytest.raises(ConfigError, match="has no x, y, z"):
        whole(ranges)
    assert whole(path, range="auto").n_lines == 1


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "n_lines", "longest"), [("car_cloud400.csv", 213, 141), ("car_cloud401.csv", 214, 142)]
)
def test_lines_of_a_rotating_profiler(real_data: Path, name: str, n_lines: int, longest: int) -> None:
    from prc_cli.formats.options import Layout, LayoutField

    fields = tuple(LayoutField(name=axis, source=index) for index, axis in enumerate("xyz"))
    layout = None if name.endswith("400.csv") else Layout(delimiter=" ", header=False, fields=fields)
    stream = open_input(real_data / "organised" / name, InputConfig(**RULES), layout)
    block = join(list(stream.blocks()))
    assert block.range_m.shape == (n_lines, longest)
    assert (block.records() >= 0).sum(axis=1).min() >= 61
