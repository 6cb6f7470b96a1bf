"""Frames for odometry: folders, clouds and bags without the points of some classes, and all else as
it was."""

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli import DoubtWarning, classify
from prc_cli.config import load_config
from prc_cli.core.errors import ConfigError, InputError, OutputError, OutputExistsError
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.formats.bags.containers import Bag
from prc_cli.formats.bags.labels import CloudCodec
from prc_cli.formats.input import Input
from prc_cli.jobs.thin import parse_rules, thin
from tests.formats import cloud_files
from tests.formats.bags.test_labels import WRITE, read_codes, recorded
from tests.jobs.test_thin import frame

GROUND = parse_rules(keep_only=["ground"])
DOUBTED = load_config(options={"input": {"accept_doubts": list(CHECK_NAMES)}})


def folder_of(tmp_path: Path) -> tuple[Path, Path, list[Any]]:
    """Four frames and their classes.

    Every third point is no ground, in the second one none is, the third is empty.
    """
    source = tmp_path / "velodyne"
    labels = tmp_path / "labels"
    points = []
    source.mkdir()
    labels.mkdir()
    for number in (8, 9, 10, 11):
        points.append(frame(source / f"{number}.bin"))
        codes = np.where((np.arange(len(points[-1])) % 3 == 0) | (number == 9), 5, 2)
        codes.astype("<u4").tofile(labels / f"{number}.label")
    (source / "10.bin").write_bytes(b"")
    (source / "notes.txt.md").write_text("no frame")
    return source, labels, points


def read(path: Path) -> Any:
    return np.fromfile(path, "<f4").reshape(-1, 4)


def test_a_folder_of_frames_keeps_every_frame(tmp_path):
    source, labels, points = folder_of(tmp_path)
    summary = thin(source, tmp_path / "ground", GROUND, labels=labels)
    assert sorted(path.name for path in (tmp_path / "ground").iterdir()) == [
        "10.bin",
        "11.bin",
        "8.bin",
        "9.bin",
    ]
    left = np.arange(len(points[0])) % 3 != 0
    for name, k in (("8", 0), ("11", 3)):
        np.testing.assert_array_equal(
            read(tmp_path / "ground" / f"{name}.bin")[:, :3], points[k][left, :3]
        )
    assert not (tmp_path / "ground" / "9.bin").stat().st_size
    assert not (tmp_path / "ground" / "10.bin").stat().st_size
    record = json.loads((tmp_path / "ground.prc.json").read_text())
    assert record["notices"] == list(summary.record.notices)
    assert summary.record.notices[-1] == "2 frames have no point: their files are there"
    assert sum(item.n_kept for item in summary.classes) == 2 * left.sum()
    thin(source, tmp_path / "numbered", GROUND, labels=labels, every_frame=True)
    names = sorted(path.name for path in (tmp_path / "numbered").iterdir())
    assert names == ["000000.bin", "000001.bin", "000002.bin", "000003.bin"]
    assert not (tmp_path / "numbered" / "000002.bin").stat().st_size


def test_points_that_share_a_cell_keep_their_intensities(tmp_path):
    points = frame(tmp_path / "f.bin")
    twice = np.repeat(points, 1 + (np.arange(len(points)) % 40 == 7), axis=0)
    twice[:, 3] = np.arange(1, len(twice) + 1)
    twice.astype("<f4").tofile(tmp_path / "f.bin")
    codes = np.where(np.arange(len(twice)) % 3 == 0, 5, 2)
    codes.astype("<u4").tofile(tmp_path / "f.label")
    thin(tmp_path / "f.bin", tmp_path / "thin.bin", GROUND, DOUBTED, labels=tmp_path / "f.label")
    np.testing.assert_array_equal(read(tmp_path / "thin.bin"), twice[codes == 2])


def test_folders_that_cannot_be_thinned_leave_nothing(tmp_path):
    source, labels, _ = folder_of(tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(OutputExistsError, match="frames go to a new folder"):
        thin(source, out, GROUND, labels=labels, overwrite=True)
    with pytest.raises(ConfigError, match="would be dropped, expected some to stay"):
        thin(source, out / "a", parse_rules(keep_only=["car"]), labels=labels)
    with pytest.raises(
        InputError, match=r"velodyne: found no frames, expected frames of one kind; name a folder"
    ):
        (tmp_path / "root" / "velodyne").mkdir(parents=True)
        thin(tmp_path / "root" / "velodyne", out / "a", GROUND)
    with pytest.raises(InputError, match="give .*velodyne"):
        thin(tmp_path / "root", out / "a", GROUND)
    with pytest.raises(InputError, match="found a file, expected a folder with the class codes"):
        thin(source, out / "a", GROUND, labels=labels / "8.label")
    with pytest.raises(ConfigError, match="the folder above it is not there"):
        thin(source, out / "b" / "a", GROUND, labels=labels)
    (labels / "9.label").unlink()
    with pytest.raises(InputError, match=r"no class codes of 1 of 4 frames: 9.bin"):
        thin(source, out / "a", GROUND, labels=labels)
    (source / "9.bin").write_bytes((source / "8.bin").read_bytes()[:-3])
    with pytest.raises(InputError, match=r"9\.bin"):
        thin(source, out / "a", GROUND, DOUBTED)
    assert not list(out.iterdir())


def test_without_classes_a_frame_is_classified_on_the_way(tmp_path):
    points = frame(tmp_path / "f.bin")
    summary = thin(tmp_path / "f.bin", tmp_path / "thin.bin", config=DOUBTED)
    assert any(
        text.startswith("classified on the way: method rings") for text in summary.record.notices
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtWarning)
        classify(tmp_path / "f.bin", tmp_path / "f.labels.npy", DOUBTED)
    kept = np.load(tmp_path / "f.labels.npy") != 7
    np.testing.assert_array_equal(read(tmp_path / "thin.bin")[:, :3], points[kept, :3])


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_points_of_frames_keep_their_times_and_rings(tmp_path, suffix):
    points = frame(tmp_path / "f.bin")
    xyz = points[:, :3]
    elevation_deg = np.rad2deg(np.arcsin(xyz[:, 2] / np.linalg.norm(xyz, axis=1)))
    columns = dict(zip(("x", "y", "z", "intensity"), points.T.copy(), strict=True))
    columns["ring"] = np.round((2.0 - elevation_deg) / 2.0).astype("<u2")
    columns["time"] = np.linspace(0.0, 0.1, len(points))
    columns["x"][7] = np.nan
    source = tmp_path / f"f{suffix}"
    source.write_bytes((cloud_files.ply if suffix == ".ply" else cloud_files.pcd)(columns))
    codes = np.where(np.arange(len(points)) % 3 == 0, 5, 2).astype(np.uint8)
    np.save(tmp_path / "labels.npy", codes)
    thin(source, tmp_path / f"thin{suffix}", GROUND, labels=tmp_path / "labels.npy")
    left = (codes == 2) & ~np.isnan(columns["x"])
    thinned = Input.of(tmp_path / f"thin{suffix}").records()
    assert thinned is not None
    assert set(thinned.dimensions) == {*columns, "class"}
    for name, column in columns.items():
        values = [chunk.values[name] for chunk in thinned.chunks((name,))]
        np.testing.assert_array_equal(np.concatenate(values), column[left])


@pytest.mark.parametrize("suffix", WRITE)
def test_a_bag_loses_points_and_nothing_else(tmp_path, suffix):
    source = recorded(tmp_path, "clouds", suffix)
    (tmp_path / "out").mkdir()
    out = tmp_path / "out" / f"thin{suffix}"
    n = sum(len(read_points(source, message)) for message in messages_of(source))
    codes = np.where(np.arange(n) % 3 == 0, 5, 2).astype(np.uint8)
    np.save(tmp_path / "labels.npy", codes)
    summary = thin(source, out, GROUND, labels=tmp_path / "labels.npy")
    before = messages_of(source)
    after = messages_of(out)
    assert len(before) == len(after)
    first = 0
    for raw_message, thinned_message in zip(before, after, strict=True):
        points = read_points(source, raw_message)
        thinned = read_points(out, thinned_message)
        stays = (
            (codes[first : first + len(points)] == 2)
            & np.isfinite(points["x"])
            & (points["x"] != 0)
        )
        first += len(points)
        for name in ("x", "y", "z", "ring", "t"):
            np.testing.assert_array_equal(thinned[name], points[name][stays])
    assert sum(item.n_kept for item in summary.classes) == len(read_codes(out))
    assert set(read_codes(out).tolist()) == {2}
    # its own classes are taken from then on
    again = thin(out, out.with_name(f"again{suffix}"), parse_rules(keep_only=["ground"]))
    assert [(item.name, item.n_kept) for item in again.classes] == [
        ("ground", len(read_codes(out)))
    ]


def messages_of(path: Path) -> list[Any]:
    bag = Bag(path)
    return [
        message
        for message in bag.messages(list(bag.counts))
        if message.topic.kind.endswith("PointCloud2")
    ]


def read_points(path: Path, message: Any) -> Any:
    codec = CloudCodec(is_cdr=path.suffix != ".bag")
    cloud, _ = codec.points(message.data, "x")
    names = {cloud_field.name: cloud_field for cloud_field in cloud.fields}
    kinds = {4: "<u2", 6: "<u4", 7: "<f4", 2: "u1"}
    point: Any = {
        "names": list(names),
        "formats": [kinds[cloud_field.datatype] for cloud_field in names.values()],
        "offsets": [cloud_field.offset for cloud_field in names.values()],
        "itemsize": cloud.point_step,
    }
    return np.frombuffer(bytes(cloud.data), np.dtype(point))


def test_laser_scans_of_a_bag_keep_their_shots(tmp_path):
    source = recorded(tmp_path, "lasers", ".bag")
    with pytest.raises(OutputError, match="laser scans have a place for every shot"):
        thin(source, tmp_path / "thin.bag", GROUND)
