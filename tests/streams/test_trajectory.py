"""Times and trajectories."""

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


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "drive.csv: empty file, expected a trajectory"),
        ("\n\n", "no column for time (one of time, gps_time, gpstime, t), found ''"),
        (
            "a,b,c\n1,2,3\n",
            "line 1: no column for time (one of time, gps_time, gpstime, t), found 'a, b, c'",
        ),
        (
            "time,x,y\n1,2,3\n",
            "line 1: no column for z (one of z, height, altitude, alt, h), found 'time, x, y'",
        ),
        ("time,x,y,z\n", "0 positions, expected at least 2"),
        ("time,x,y,z\n1,2,3,4\n", "1 positions, expected at least 2"),
        ("time,x,y,z\n1,2,3,4\n2,3,four,5\n", "line 3: cell 3 is 'four', expected a finite number"),
        (
            "time,x,y,z\n1,2,3,4\n\n# c\n2,3,4,nan\n",
            "line 5: cell 4 is 'nan', expected a finite number",
        ),
        ("time,x,y,z\n1,2,3,4\n2,3\n", "line 3: 2 cells, expected at least 4"),
        (
            "time,x,y,z\n1,0,0,0\n3,0,0,0\n2,0,0,0\n",
            "position 3 (counted from 1) has time 2.000000 s after 3.000000 s",
        ),
        (
            "time,x,y,z\n1,0,0,0\n1,0,0,0\n",
            "position 2 (counted from 1) has time 1.000000 s after 1.000000 s",
        ),
        ("time,x,y,z\n" + "1" * 70_000, "line 2: row of more than 65536 characters"),
    ],
)
def test_damaged_text_is_named(tmp_path, text, message):
    with pytest.raises(InputError) as caught:
        load(write(tmp_path / "drive.csv", text))
    assert message in str(caught.value)
    assert "drive.csv" in caught.value.where
    assert caught.value.hint
    assert "\n" not in str(caught.value)


def test_sbet_is_projected_and_keeps_altitudes(tmp_path):
    pyproj = pytest.importorskip("pyproj")
    path = write_sbet(
        tmp_path / "drive.sbet",
        [
            (1.0, math.radians(60.1), math.radians(24.9), 31.5),
            (2.0, math.radians(60.2), math.radians(25.0), 32.5),
        ],
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
    "crs, heights, alone",
    [
        ("EPSG:3067+5717", "N60 height", "EPSG:3067"),
        ("EPSG:32635+5773", "EGM96 height", "EPSG:32635"),
    ],
)
@pytest.mark.parametrize("form", ["code", "wkt1", "wkt2"])
def test_heights_of_another_kind_never_pass_in_silence(
    tmp_path,
    crs,
    heights,
    alone,
    form,
):
    pyproj = pytest.importorskip("pyproj")
    path = write_sbet(tmp_path / "drive.sbet", SOUND)
    options = {
        "code": crs,
        "wkt1": pyproj.CRS(crs).to_wkt("WKT1_GDAL"),
        "wkt2": pyproj.CRS(crs).to_wkt(),
    }[form]
    for keys in ({"crs": options}, {"wkt": options}):
        with pytest.raises(ConfigError) as caught:
            load(path, **keys)
        assert f"has heights of its own ({heights!r}), but heights of an SBET are" in str(
            caught.value
        )
        assert (
            f"set trajectory_crs = {alone} if the points' heights are above the ellipsoid too"
            in caught.value.hint
        )
        assert "\n" not in str(caught.value)
    # what the hint says is enough, although the points' file still says the other
    np.testing.assert_array_equal(load(path, crs=alone, wkt=options).xyz_m[:, 2], [3.0, 3.0])


SOUND = [(0.0, 1.0, 0.4, 3.0), (1.0, 1.0, 0.4, 3.0)]


def test_sbet_without_a_coordinate_system(tmp_path):
    with pytest.raises(ConfigError, match="set trajectory_crs, for example EPSG:32635"):
        load(write_sbet(tmp_path / "drive.sbet", SOUND))


@pytest.mark.parametrize(
    "crs, message",
    [
        ("EPSG:4326", "'EPSG:4326' is not a projected one in metres"),
        ("EPSG:2263", "'EPSG:2263' is not a projected one in metres"),
        ("nonsense", "'nonsense' cannot be used"),
    ],
)
def test_sbet_with_an_unusable_coordinate_system(tmp_path, crs, message):
    pytest.importorskip("pyproj")
    with pytest.raises(ConfigError) as caught:
        load(write_sbet(tmp_path / "drive.sbet", SOUND), crs=crs)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_sbet_without_pyproj_names_the_remedy(tmp_path, monkeypatch):
    plain_import = builtins.__import__

    def no_pyproj(name: str, *args: Any) -> Any:
        if name.startswith("pyproj"):
            raise ModuleNotFoundError(name)
        return plain_import(name, *args)

    monkeypatch.setattr(builtins, "__import__", no_pyproj)
    with pytest.raises(ConfigError, match=r"pip install .\.\[crs\]."):
        load(write_sbet(tmp_path / "drive.sbet", SOUND), crs=UTM35)


# -- trajectories


def track(*time_s: float, gap: float | None = None) -> Trajectory:
    n = len(time_s)
    return Trajectory("drive.csv", np.array(time_s), np.arange(3.0 * n).reshape(n, 3), gap)


WEEK = 604_800.0


@pytest.mark.parametrize(
    "offset, hint",
    [
        (WEEK, "differ by +1 GPS weeks: try --set input.trajectory_time_offset=604800"),
        (-2 * WEEK, "differ by -2 GPS weeks: try --set input.trajectory_time_offset=-1209600"),
        (-1e9, "differ by -1e+09 s: try --set input.trajectory_time_offset=-1000000000"),
        (
            1e9 + WEEK,
            (
                "differ by +1 GPS weeks and +1e+09 s: try --set "
                "input.trajectory_time_offset=1000604800"
            ),
        ),
        (2300 * WEEK, "try --set input.trajectory_time_offset=1391040000"),  # the full GPS time
        # points take 10 s, the trajectory 16: so far apart that the middles may be 3 s and one more
        # off
        (WEEK + 4.0, "+1 GPS weeks"),
        (WEEK + 4.01, None),
        (WEEK - 3.99, "+1 GPS weeks"),
        (500.0, None),
        (1e15, None),
    ],
)
def test_clocks_that_differ_by_weeks(offset, hint):
    path = track(*(300_000.0 + np.arange(17.0)).tolist())
    with pytest.raises(InputError) as refused:
        path.positions(300_003.0 + np.arange(11.0) + offset)
    if hint is None:
        assert (
            refused.value.hint
            == "give the trajectory of this drive, or set trajectory_time_offset to what its "
            "times lack"
        )
    else:
        assert refused.value.hint is not None
        assert hint in refused.value.hint


# -- weeks and orders


@pytest.mark.parametrize(
    "text",
    [
        "time;x;y;z\n0,5;1,25;2;3\n1,5;2,25;2;3\n",
        "0,5\t1,25\t2,0\t3,0\n1,5\t2,25\t2,0\t3,0\n",
        "time x y z\n0,5 1,25 2 3\n1,5 2,25 2 3\n",
        "time;x;y;z\n0.5;1.25;2;3\n1.5;2.25;2;3\n",
    ],
)
def test_decimals_behind_a_comma_are_found(tmp_path, text):
    path = load(write(tmp_path / "path.csv", text))
    np.testing.assert_allclose(path.time_s, [0.5, 1.5])
    np.testing.assert_allclose(path.positions(np.array([0.5, 1.5])), [[1.25, 2, 3], [2.25, 2, 3]])
