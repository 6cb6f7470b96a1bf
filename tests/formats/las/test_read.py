"""LAS and LAZ, read: every dimension as laspy has it, and headers that lie."""

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.las.read import LasSource
from prc_cli.formats.records import Reading
from tests.formats.las.lasbytes import make_las

VERSION = {
    **dict.fromkeys(range(4), "1.2"),
    4: "1.3",
    5: "1.3",
    **dict.fromkeys(range(6, 11), "1.4"),
}
ANGLE = {True: ("scan_angle", 0.006), False: ("scan_angle_rank", 1.0)}


def make(path: Path, point_format: int = 6, n: int = 200, **options: Any) -> laspy.LasData:
    """Write a file with every dimension filled at random; returns what laspy holds."""
    options = {"extra": (), "raw_points": True, **options}
    make_las(path, point_format, n=n, seed=point_format, **options)
    las = laspy.read(path)
    las.header.generating_software = "laspy"  # what make_las wrote is no text
    kinds = las.points.array.dtype
    for name in [name for name in kinds.names or () if kinds[name].base.kind == "f"]:
        values = np.random.default_rng(1).normal(size=las.points.array[name].shape)
        las.points.array[name] = np.sort(values, axis=0)
    las.write(path)
    return las


def read(source: LasSource, name: str) -> np.ndarray[Any, Any]:
    chunks = list(source.chunks((name,)))
    assert [chunk.first_record for chunk in chunks] == list(
        np.cumsum([0] + [chunk.n for chunk in chunks])[:-1]
    )
    return np.concatenate([chunk.values[name] for chunk in chunks])


def expected(las: laspy.LasData, name: str) -> np.ndarray[Any, Any]:
    """What laspy says, in the units of this program."""
    if name == "angle":
        field, step = ANGLE[las.header.point_format.id >= 6]
        return np.radians(np.asarray(las[field], np.float64) * step)
    return np.asarray(las[{"time": "gps_time"}.get(name, name)])


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("point_format", range(11))
def test_every_dimension_of_every_point_format(tmp_path, point_format, suffix):
    path = tmp_path / f"drive.{suffix}"
    make(
        path,
        point_format,
        extra=[laspy.ExtraBytesParams("range", "f4"), laspy.ExtraBytesParams("column", "u2")],
    )
    las = laspy.read(path)
    source = LasSource(path)
    assert (source.n_records, source.header.point_format) == (200, point_format)
    assert source.facts.header["version"] == VERSION[point_format]
    assert source.format == suffix.upper()
    renamed = {"X", "Y", "Z", "gps_time", "scan_angle", "scan_angle_rank"}
    names = set(las.header.point_format.dimension_names) - renamed | {"x", "y", "z", "angle"}
    assert set(source.dimensions) == names | ({"time"} if point_format not in (0, 2) else set())
    for name in source.dimensions:
        values = read(source, name)
        if name == "angle":
            np.testing.assert_allclose(values, expected(las, name), rtol=1e-15)
        else:
            np.testing.assert_array_equal(values, expected(las, name), err_msg=name)
        if name in ("range", "x", "y", "z", "time", "angle"):
            assert values.dtype == np.float64


@pytest.mark.slow
@pytest.mark.parametrize("first_pair", [0, 60_000, None])
def test_spared_intensity_is_there_wherever_it_may_decide(tmp_path, first_pair):
    n = 120_001
    number = np.ones(n, np.uint8)
    if first_pair is not None:
        number[first_pair] = 2
        number[first_pair + 700 :: 31] = 15
    path = tmp_path / "drive.laz"
    las = make(path, n=n)
    las.return_number[:] = 1
    las.number_of_returns[:] = number
    las.write(path)
    plain = LasSource(path, 33_333)
    source = plain.with_reading(Reading(spares_intensity=True))
    chunks = list(source.chunks(("time", "number_of_returns", "intensity")))
    times, numbers, spared = (
        np.concatenate([chunk.values[name] for chunk in chunks]) for name in chunks[0].values
    )
    np.testing.assert_array_equal(times, las.gps_time)
    np.testing.assert_array_equal(numbers, number)
    intensity = np.asarray(las.intensity)
    np.testing.assert_array_equal(spared[number > 1], intensity[number > 1])
    if first_pair is None:
        assert np.any(spared != intensity)  # it was not decoded
    np.testing.assert_array_equal(read(plain, "intensity"), intensity)
    # what the writer of labels needs is the same
    kept = []
    for reader in (source, plain):
        assert reader.laz_contexts is not None
        kept.append(np.concatenate(list(reader.laz_contexts.take(n))))
    np.testing.assert_array_equal(*kept)


def test_scaled_extra_bytes_and_no_data(tmp_path):
    extra = [
        laspy.ExtraBytesParams("range", "u2", scales=[0.005], offsets=[1.0], no_data=[0]),
        laspy.ExtraBytesParams("scan_line", "i4", no_data=[-1]),
        laspy.ExtraBytesParams("plain", "i2"),
        laspy.ExtraBytesParams("normal", "3f4"),
        laspy.ExtraBytesParams("gauge", "f4", no_data=[-9999.25]),
    ]
    las = make(tmp_path / "a.las", n=5, extra=extra)
    stored = las.points.array
    stored["range"] = [0, 1, 200, 65535, 0]
    stored["scan_line"] = [-1, 0, 1, 2, -1]
    stored["gauge"] = [-9999.25, 1, 2, 3, 4]
    las.write(tmp_path / "a.las")
    source = LasSource(tmp_path / "a.las")
    np.testing.assert_array_equal(read(source, "range"), [np.nan, 1.005, 2.0, 328.675, np.nan])
    np.testing.assert_array_equal(read(source, "scan_line"), [np.nan, 0, 1, 2, np.nan])
    np.testing.assert_array_equal(read(source, "gauge"), [np.nan, 1, 2, 3, 4])
    assert read(source, "plain").dtype == np.int16
    assert "normal" not in source.dimensions  # three numbers a record


@pytest.mark.parametrize(
    "name, description, radians",
    [
        ("angle", "", np.pi / 180),
        ("angle_deg", "", np.pi / 180),
        ("angle", "scan angle [rad]", 1.0),
        ("scan_angle_deg", "", np.pi / 180),
        ("theta", "", 1.0),
        ("theta_deg", "", np.pi / 180),
        ("Azimuth", "in degrees", np.pi / 180),
        ("zenith_rad", "", 1.0),
        ("angle_gon", "", np.pi / 200),
    ],
)
def test_extra_bytes_of_usual_names(
    tmp_path,
    name,
    description,
    radians,
):
    """An angle beside range, line and column was renamed and ignored.

    PRC, exit 0, ground F1 .50 for .99.
    """
    said = [laspy.ExtraBytesParams(name, "f4", description), laspy.ExtraBytesParams("line", "i4")]
    data = make(tmp_path / "a.las", n=9, extra=[*said, laspy.ExtraBytesParams("range_mm", "i4")])
    source = LasSource(tmp_path / "a.las")
    assert {"angle", "scan_line", "range", "scan_angle"} <= set(source.dimensions)
    np.testing.assert_allclose(read(source, "angle"), np.asarray(data[name], np.float64) * radians)
    np.testing.assert_array_equal(read(source, "scan_line"), data["line"])
    np.testing.assert_allclose(read(source, "range"), np.asarray(data["range_mm"]) * 0.001)
    rule = source.facts.rule("nadir")
    assert (rule is not None) == name.startswith("zenith")


def test_a_file_that_shrinks_while_it_is_read(tmp_path):
    path = tmp_path / "a.las"
    make(path, 1)
    chunks = LasSource(path, 50).chunks(("x",))
    next(chunks)
    path.write_bytes(path.read_bytes()[: 227 + 28 * 110 + 5])
    with pytest.raises(
        InputError, match=r"the file ends at record 1\d\d, expected 200: it changed while read"
    ):
        list(chunks)


@pytest.mark.parametrize(
    "name, read_as, factor", [("range_mm", "range", 0.001), ("level", "level", 1.0)]
)
def test_extra_bytes_with_an_offset_alone_have_it_in_their_unit(
    tmp_path,
    name,
    read_as,
    factor,
):
    path = tmp_path / "a.las"
    las = make(
        path, 6, n=5, extra=[laspy.ExtraBytesParams(name, "i4", scales=[1.0], offsets=[500.0])]
    )
    data = bytearray(path.read_bytes())
    data[data.index(name.encode() + b"\0") - 1] = 0x10  # options: no scale
    path.write_bytes(data)
    stored = las.points.array[name].astype(np.float64)
    np.testing.assert_allclose(read(LasSource(path), read_as), (stored + 500.0) * factor)
