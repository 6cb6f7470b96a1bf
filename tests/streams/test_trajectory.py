from __future__ import annotations

import builtins
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.streams.trajectory import Trajectory, load_trajectory

UTM35 = "EPSG:32635"


def load(
    path: Path,
    crs: str | None = None,
    wkt: str | None = None,
    offset: float = 0.0,
    max_gap: float | None = None,
) -> Trajectory:
    return load_trajectory(path, crs=crs, source_crs_wkt=wkt, time_offset=offset, max_gap=max_gap)


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def write_sbet(path: Path, rows: list[tuple[float, float, float, float]]) -> Path:
    values = np.zeros((len(rows), 17))
    values[:, :4] = rows
    path.write_bytes(values.astype("<f8").tobytes())
    return path


def test_positions_lie_on_straight_lines_between_the_given_ones(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.csv", "time,x,y,z\n10,0,0,100\n11,10,-20,100\n13,10,0,104\n")
    track = load(path)
    expected = [[0, 0, 100], [5, -10, 100], [10, -20, 100], [10, -10, 102], [10, 0, 104]]
    np.testing.assert_allclose(track.positions(np.array([10, 10.5, 11, 12, 13])), expected, atol=1e-12)
    assert track.positions(np.empty(0)).shape == (0, 3)


@pytest.mark.parametrize(
    "text",
    [
        "gps_time;easting;northing;height\n1;2;3;4\n2;3;4;5\n",
        "T\tE\tN\tAlt\n1\t2\t3\t4\n2\t3\t4\t5\n",
        "# t x y h\n# made by hand\n1  2 3   4\n\n2 3 4 5\n",
        '"x","y","z","roll","time"\n"2","3","4","0.1","1"\n"3","4","5","0.1","2"\n',
        "\ufefftime [s],x (m),y (m),altitude (m)\r\n1,2,3,4\r\n2,3,4,5\r\n",
        "time,height,z,x,y\n1,9,4,2,3\n2,9,5,3,4\n",
    ],
)
def test_delimiters_and_names(tmp_path: Path, text: str) -> None:
    track = load(write(tmp_path / "drive.txt", text))
    np.testing.assert_array_equal(track.time_s, [1, 2])
    np.testing.assert_array_equal(track.xyz_m, [[2, 3, 4], [3, 4, 5]])


def test_many_rows_cross_the_batches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("prc_cli.formats.trajectory._BATCH", 7)
    rows = "".join(f"{t},{2 * t},0,1\n" for t in range(100))
    track = load(write(tmp_path / "drive.csv", "time,x,y,z\n" + rows))
    np.testing.assert_array_equal(track.xyz_m[:, 0], np.arange(100) * 2.0)


@pytest.mark.parametrize("delimiter", [" ", ",", ";", "\t"])
def test_four_columns_without_names_are_time_and_position(tmp_path: Path, delimiter: str) -> None:
    rows = "".join(delimiter.join(row) + "\n" for row in (("1", "2", "3", "4"), ("2", "3", "4", "5")))
    track = load(write(tmp_path / "drive.txt", rows))
    np.testing.assert_array_equal(track.xyz_m, [[2, 3, 4], [3, 4, 5]])


def test_offset_is_added_to_the_times(tmp_path: Path) -> None:
    track = load(write(tmp_path / "drive.csv", "time,x,y,z\n1,0,0,0\n2,1,0,0\n"), offset=604_800.0)
    assert track.positions(np.array([604_801.5]))[0, 0] == 0.5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "drive.csv: empty file, expected a trajectory"),
        ("\n\n", "no column for time (one of time, gps_time, gpstime, t), found ''"),
        ("a,b,c\n1,2,3\n", "line 1: no column for time (one of time, gps_time, gpstime, t), found 'a, b, c'"),
        ("time,x,y\n1,2,3\n", "line 1: no column for z (one of z, height, altitude, alt, h), found 'time, x, y'"),
        ("time,x,y,z\n", "0 positions, expected at least 2"),
        ("time,x,y,z\n1,2,3,4\n", "1 positions, expected at least 2"),
        ("time,x,y,z\n1,2,3,4\n2,3,four,5\n", "line 3: cell 3 is 'four', expected a finite number"),
        ("time,x,y,z\n1,2,3,4\n\n# c\n2,3,4,nan\n", "line 5: cell 4 is 'nan', expected a finite number"),
        ("time,x,y,z\n1,2,3,4\n2,3\n", "line 3: 2 cells, expected at least 4"),
        ("time,x,y,z\n1,0,0,0\n3,0,0,0\n2,0,0,0\n", "position 3 (counted from 1) has time 2.000000 s after 3.000000 s"),
        ("time,x,y,z\n1,0,0,0\n1,0,0,0\n", "position 2 (counted from 1) has time 1.000000 s after 1.000000 s"),
        ("time,x,y,z\n" + "1" * 70_000, "line 2: row of more than 65536 characters"),
    ],
)
def test_damaged_text_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        load(write(tmp_path / "drive.csv", text))
    assert message in str(caught.value)
    assert "drive.csv" in caught.value.where
    assert caught.value.hint
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"drive.csv: cannot be read \(No such file"):
        load(tmp_path / "drive.csv")


def test_times_outside_name_both_spans() -> None:
    track = Trajectory("drive.csv", np.array([100.0, 200.0]), np.zeros((2, 3)))
    with pytest.raises(InputError) as caught:
        track.positions(np.array([150.0, 200.5, 99.0]))
    assert str(caught.value) == (
        "drive.csv: 2 of 3 point times are outside the trajectory: points from 99.00 to 200.50 s, trajectory from "
        "100.00 to 200.00 s; give the trajectory of this drive, or set trajectory_time_offset to what its times lack"
    )


@pytest.mark.parametrize("times", [[np.nan], [150.0, np.nan], [np.inf, 150.0]])
def test_times_that_are_no_numbers_never_pass(times: list[float]) -> None:
    track = Trajectory("drive.csv", np.array([100.0, 200.0]), np.zeros((2, 3)))
    with pytest.raises(InputError, match="NaN or infinite"):
        track.positions(np.array(times))


@pytest.mark.parametrize(
    ("point_clock", "offset"),
    [
        (lambda t: t + 2 * 604_800, 2 * 604_800),  # the drive went on for two weeks of another clock
        (lambda t: t + 2300 * 604_800 - 1e9, 2300 * 604_800 - 1_000_000_000),  # adjusted standard GPS time
        (lambda t: t + 2300 * 604_800, 2300 * 604_800),  # full GPS time
    ],
)
def test_gps_week_and_adjusted_time_are_recognised(point_clock: Any, offset: int) -> None:
    track = Trajectory("drive.csv", np.array([300_000.0, 303_600.0]), np.zeros((2, 3)))
    with pytest.raises(InputError) as caught:
        track.positions(point_clock(np.array([301_000.0, 303_000.0])))
    assert caught.value.hint.endswith(f"try trajectory_time_offset = {offset}")


def test_full_gps_trajectory_of_adjusted_points_is_recognised() -> None:
    full = 2300 * 604_800 + 5000.0
    track = Trajectory("drive.csv", np.array([full, full + 60]), np.zeros((2, 3)))
    with pytest.raises(InputError) as caught:
        track.positions(np.array([full - 1e9 + 10]))
    assert "differ by -1e+09 s: try trajectory_time_offset = -1000000000" in caught.value.hint


def test_sbet_is_projected_and_keeps_altitudes(tmp_path: Path) -> None:
    pyproj = pytest.importorskip("pyproj")
    path = write_sbet(
        tmp_path / "drive.sbet",
        [(1.0, math.radians(60.1), math.radians(24.9), 31.5), (2.0, math.radians(60.2), math.radians(25.0), 32.5)],
    )
    track = load(path, crs=UTM35)
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", UTM35)  # its own axis order: latitude first
    np.testing.assert_allclose(track.xyz_m[0, :2], to_utm.transform(60.1, 24.9), atol=1e-6)
    np.testing.assert_allclose(track.xyz_m[1, :2], to_utm.transform(60.2, 25.0), atol=1e-6)
    np.testing.assert_array_equal(track.xyz_m[:, 2], [31.5, 32.5])
    from_wkt = load(path, wkt=pyproj.CRS(UTM35).to_wkt())
    np.testing.assert_array_equal(from_wkt.xyz_m, track.xyz_m)
    of_3d = load(path.rename(tmp_path / "drive.out"), wkt=pyproj.CRS(UTM35).to_3d().to_wkt())
    np.testing.assert_array_equal(of_3d.xyz_m, track.xyz_m)


@pytest.mark.parametrize(
    ("crs", "heights", "alone"),
    [("EPSG:3067+5717", "N60 height", "EPSG:3067"), ("EPSG:32635+5773", "EGM96 height", "EPSG:32635")],
)
@pytest.mark.parametrize("form", ["code", "wkt1", "wkt2"])
def test_heights_of_another_kind_never_pass_in_silence(
    tmp_path: Path, crs: str, heights: str, alone: str, form: str
) -> None:
    pyproj = pytest.importorskip("pyproj")
    path = write_sbet(tmp_path / "drive.sbet", SOUND)
    given = {"code": crs, "wkt1": pyproj.CRS(crs).to_wkt("WKT1_GDAL"), "wkt2": pyproj.CRS(crs).to_wkt()}[form]
    for keys in ({"crs": given}, {"wkt": given}):
        with pytest.raises(ConfigError) as caught:
            load(path, **keys)
        assert f"has heights of its own ({heights!r}), expected a horizontal one: the altitudes" in str(caught.value)
        assert f"set trajectory_crs = {alone} if the points' heights are above the ellipsoid too" in caught.value.hint
        assert "\n" not in str(caught.value)
    # what the hint says is enough, although the points' file still says the other
    np.testing.assert_array_equal(load(path, crs=alone, wkt=given).xyz_m[:, 2], [3.0, 3.0])


def test_a_system_whose_heights_are_bound_to_a_geoid(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    crs = "+proj=utm +zone=35 +ellps=GRS80 +geoidgrids=egm96_15.gtx +units=m"
    with pytest.raises(ConfigError, match=r"heights of its own .* set trajectory_crs = its horizontal part if"):
        load(write_sbet(tmp_path / "drive.sbet", SOUND), crs=crs)


def test_what_is_recorded_of_a_trajectory(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.csv", "time,x,y,z\n10,0,0,0\n11,0,0,0\n12.5,1,0,0\n")
    track = load(path, offset=100.0)
    assert (track.n_positions, track.span) == (3, (110.0, 112.5))


GAPPY = "time,x,y,z\n900,0,0,0\n901,1,0,0\n2000,2,0,0\n"


def test_a_gap_is_not_crossed_in_a_straight_line(tmp_path: Path) -> None:
    track = load(write(tmp_path / "drive.csv", GAPPY))
    with pytest.raises(InputError) as caught:
        track.positions(np.array([900.5, 1500.0, 1999.0, 2000.0]))
    assert str(caught.value).removeprefix(f"{tmp_path}/") == (
        "drive.csv: no position from 901.00 to 2000.00 s, a gap of 1099.00 s that holds the point time 1500.00 s; "
        "expected gaps of at most 10.00 s (2 of 4 point times are in such gaps); "
        "give the whole trajectory, or set trajectory_max_gap = 1099 to take straight lines across"
    )


def test_a_gap_without_points_does_not_matter(tmp_path: Path) -> None:
    track = load(write(tmp_path / "drive.csv", GAPPY))
    np.testing.assert_array_equal(track.positions(np.array([900.25, 901.0, 2000.0, 900.0]))[:, 0], [0.25, 1.0, 2.0, 0])


@pytest.mark.parametrize(("max_gap", "refused"), [(None, True), (1098.9, True), (1099.0, False), (1e9, False)])
def test_the_longest_gap_is_a_choice(tmp_path: Path, max_gap: float | None, refused: bool) -> None:
    track = load(write(tmp_path / "drive.csv", GAPPY), max_gap=max_gap)
    if refused:
        with pytest.raises(InputError, match="a gap of 1099.00 s"):
            track.positions(np.array([1450.5]))
    else:
        assert track.positions(np.array([1450.5]))[0, 0] == 1.5


@pytest.mark.parametrize(("step", "limit"), [(0.005, 1.0), (0.1, 1.0), (0.5, 5.0), (30.0, 300.0)])
def test_the_default_gap_follows_the_step(step: float, limit: float) -> None:
    times = np.arange(50, dtype=np.float64) * step
    times[25:] += limit - step
    track = Trajectory("drive.csv", times, np.zeros((50, 3)))
    assert track.gap_limit_s == pytest.approx(limit)
    between = (times[24] + times[25]) / 2
    late = times.copy()
    late[25:] += 0.01 * step
    longer = Trajectory("drive.csv", late, np.zeros((50, 3)))
    with pytest.raises(InputError, match=r"\(1 of 1 point times are in such gaps\)"):
        longer.positions(np.array([between]))
    exact = Trajectory("drive.csv", times, np.zeros((50, 3)), max_gap_s=float(np.diff(times).max()))
    assert exact.positions(np.array([between])).shape == (1, 3)


def test_every_one_of_many_gaps_is_seen() -> None:
    times = np.concatenate([np.arange(10.0) + 1000.0 * k for k in range(4)])
    track = Trajectory("drive.csv", times, np.zeros((40, 3)))
    for k in range(3):
        with pytest.raises(InputError, match=rf"no position from {1000 * k + 9}.00 to {1000 * k + 1000}.00 s"):
            track.positions(np.array([0.0, 3005.5, 1000.0 * k + 500]))
    assert track.positions(times + np.where(times % 1000 < 9, 0.5, 0.0)).shape == (40, 3)


@pytest.mark.parametrize(
    ("rows", "at", "said"),
    [
        (["-1.7e308", "0", "1.7e308"], 1.79e308, "trajectory from -1.7e+308 to 1.7e+308 s; give the trajectory of"),
        (["1e300", "2e300"], 5.0, "points from 5.00 to 5.00 s, trajectory from 1e+300 to 2e+300 s; give the traj"),
        (["0", "1", "1e300"], 1e299, "from 1.00 to 1e+300 s, a gap of 1e+300 s that holds the point time 1e+299 s; "),
    ],
)
def test_times_as_large_as_floats_can_be(tmp_path: Path, rows: list[str], at: float, said: str) -> None:
    path = write(tmp_path / "drive.csv", "time,x,y,z\n" + "".join(f"{t},0,0,0\n" for t in rows))
    track = load(path)
    with pytest.raises(InputError) as caught:
        track.positions(np.array([at, at]))
    assert said in str(caught.value)


@pytest.mark.parametrize(("offset", "times"), [(1e300, ("0", "1")), (1e308, ("1.6e308", "1.7e308"))])
def test_an_offset_that_swallows_the_times(tmp_path: Path, offset: float, times: tuple[str, str]) -> None:
    path = write(tmp_path / "drive.csv", "time,x,y,z\n" + "".join(f"{t},0,0,0\n" for t in times))
    with pytest.raises(InputError, match=r"position 2 \(counted from 1\) has time .* expected times that increase"):
        load(path, offset=offset)


def test_sbet_of_a_wrong_size(tmp_path: Path) -> None:
    path = tmp_path / "drive.sbet"
    path.write_bytes(b"\0" * 300)
    with pytest.raises(InputError, match="300 bytes, expected a multiple of 136"):
        load(path, crs=UTM35)


@pytest.mark.parametrize("row", [(1.0, 60.1, 0.4, 3.0), (1.0, 1.0, math.nan, 3.0)])
def test_sbet_with_impossible_numbers(tmp_path: Path, row: tuple[float, float, float, float]) -> None:
    path = write_sbet(tmp_path / "drive.sbet", [(0.0, 1.0, 0.4, 3.0), row])
    with pytest.raises(InputError, match=r"record 1 \(byte 136\): time, latitude, longitude, altitude are 1, "):
        load(path, crs=UTM35)


SOUND = [(0.0, 1.0, 0.4, 3.0), (1.0, 1.0, 0.4, 3.0)]


def test_sbet_without_a_coordinate_system(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="set trajectory_crs, for example EPSG:32635"):
        load(write_sbet(tmp_path / "drive.sbet", SOUND))


@pytest.mark.parametrize(
    ("crs", "message"),
    [
        ("EPSG:4326", "'EPSG:4326' is not a projected one in metres"),
        ("EPSG:2263", "'EPSG:2263' is not a projected one in metres"),
        ("nonsense", "'nonsense' cannot be used"),
    ],
)
def test_sbet_with_an_unusable_coordinate_system(tmp_path: Path, crs: str, message: str) -> None:
    pytest.importorskip("pyproj")
    with pytest.raises(ConfigError) as caught:
        load(write_sbet(tmp_path / "drive.sbet", SOUND), crs=crs)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_sbet_without_pyproj_names_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain_import = builtins.__import__

    def no_pyproj(name: str, *args: Any) -> Any:
        if name.startswith("pyproj"):
            raise ModuleNotFoundError(name)
        return plain_import(name, *args)

    monkeypatch.setattr(builtins, "__import__", no_pyproj)
    with pytest.raises(ConfigError, match=r"pip install prc-cli\[crs\]"):
        load(write_sbet(tmp_path / "drive.sbet", SOUND), crs=UTM35)
