"""A window of a drive: --only."""

import json

import laspy
import numpy as np
import pytest

from tests.simulated import drive_arrays

N_LINES = 60
M = 360
HZ = 10.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One drive in several formats; its times begin at 1000 s."""
    place = tmp_path_factory.mktemp("window")
    block, _ = drive_arrays(N_LINES, M, 20)
    time_s = 1000.0 + np.arange(N_LINES * M).reshape(N_LINES, M) / (HZ * M)
    assert block.angle_rad is not None
    np.savez(place / "d.npz", range_m=block.range_m, angle_rad=block.angle_rad, time_s=time_s)
    from prc_cli.jobs.convert import convert

    for name in ("d.laz", "d.csv", "d.ply", "d.bin"):
        convert(place / "d.npz", place / name)
    return place


URBAN = ("--preset", "prc-2019-urban", "-q", "--overwrite")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, window, key",
    [
        ("d.npz", "13:41", "only_lines"),
        ("d.laz", "1001.3:1004.1", "only_time"),
        ("d.csv", "+1.28:+4.08", "only_time"),
        ("d.ply", "13:41", "only_lines"),
    ],
)
def test_a_window_is_a_drive_of_its_own(
    prc,
    folder,
    name,
    window,
    key,
):
    whole = np.load(folder / "d.npz")["range_m"][13:41]
    np.save(folder / "part.npy", whole)
    assert prc(f"classify {folder}/part.npy {folder}/expected.npy", *URBAN).code == 0
    assert prc(f"classify {folder}/{name} {folder}/w.npy --only {window}", *URBAN).code == 0
    expected = np.load(folder / "expected.npy")
    expected = expected[expected > 0] if name == "d.laz" else expected
    assert np.array_equal(np.load(folder / "w.npy"), expected)
    record = json.loads((folder / "w.npy.prc.json").read_text())
    assert record["config"]["input"][key] == window
    assert record["stream"]["n_lines"] == 28
    assert record["stream"]["n_records"] == len(expected)
    assert record["input"]["sha256"] is None
    assert any("only lines 13 to 40 were taken" in notice for notice in record["notices"])


def test_las_holds_the_records_of_the_window_alone(prc, folder):
    source = laspy.read(folder / "d.laz")
    inside = (source.scan_line >= 13) & (source.scan_line < 41)
    for output in ("w.laz", "w.las"):
        result = prc(f"classify {folder}/d.laz {folder}/{output} --only 13:41", *URBAN)
        assert result.code == 0, result.err
        cloud = laspy.read(folder / output)
        assert cloud.header.point_count == np.count_nonzero(inside)
        for name in source.point_format.dimension_names:
            if name != "classification":
                assert np.array_equal(cloud[name], source[name][inside]), name
        xyz = np.stack([cloud.x, cloud.y, cloud.z])
        assert np.allclose(cloud.header.mins, xyz.min(axis=1), atol=1e-9)
        assert np.allclose(cloud.header.maxs, xyz.max(axis=1), atol=1e-9)
        assert cloud.header.number_of_points_by_return[0] == np.count_nonzero(
            cloud.return_number == 1
        )
    assert prc(f"classify {folder}/d.laz {folder}/w.npy --only 13:41", *URBAN).code == 0
    assert np.array_equal(laspy.read(folder / "w.laz").classification, np.load(folder / "w.npy"))
    # codes above 31 make the point format a larger one; segment ids are appended
    result = prc(
        f"classify {folder}/d.laz {folder}/s.laz --only 2s --set output.segment_ids=true",
        *URBAN,
    )
    assert result.code == 0, result.err
    assert laspy.read(folder / "s.laz").header.point_count == np.count_nonzero(
        source.scan_line < 20
    )


def test_evaluate_scores_the_window(prc, folder):
    assert prc(f"classify {folder}/d.laz {folder}/e.laz", *URBAN).code == 0
    source = laspy.read(folder / "d.laz")
    since_s = source.gps_time - source.gps_time[0]
    command = f"evaluate {folder}/e.laz {folder}/e.laz --only"
    in_lines = (source.scan_line >= 20) & (source.scan_line < 50)
    assert prc.json(f"{command} 20:50")["n_scored"] == in_lines.sum()
    in_time = (since_s >= 2) & (since_s < 5)
    assert prc.json(f"{command} +2:+5")["n_scored"] == in_time.sum()
    parts = prc.json(f"{command} 20:50 --by lines:10")["splits"]["lines"]
    assert {part["name"]: part["n_scored"] for part in parts} == {
        f"lines {low}-{low + 9}": (source.scan_line // 10 == low // 10).sum()
        for low in (20, 30, 40)
    }
