from __future__ import annotations

import builtins
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.readers.trajectory import Trajectory, load_trajectory

UTM35 = "EPSG:32635"


def load(path: Path, crs: str | None = None, wkt: str | None = None, offset: float = 0.0) -> Trajectory:
    return load_trajectory(path, crs=crs, source_crs_wkt=wkt, time_offset=offset)


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
    monkeypatch.setattr("prc_cli.readers.trajectory._BATCH", 7)
    rows = "".join(f"{t},{2 * t},0,1\n" for t in range(100))
    track = load(write(tmp_path / "drive.csv", "time,x,y,z\n" + rows))
    np.testing.assert_array_equal(track.xyz_m[:, 0], np.arange(100) * 2.0)


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
    compound = load(path.rename(tmp_path / "drive.out"), crs="EPSG:32635+5773")
    np.testing.assert_array_equal(compound.xyz_m, track.xyz_m)


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
