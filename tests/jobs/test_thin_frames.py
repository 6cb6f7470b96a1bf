"""Frames for odometry: folders, clouds and bags without the points of some classes, and all else as
it was."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.formats.bags.containers import Bag
from prc_cli.formats.bags.labels import CloudCodec
from prc_cli.formats.input import Input
from prc_cli.jobs.thin import parse_rules, thin
from tests.formats import cloud_files
from tests.formats.bags.test_labels import WRITE, read_codes, recorded
from tests.golden.inputs import frame

GROUND = parse_rules(keep_only=["ground"])


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_points_of_frames_keep_their_times_and_rings(tmp_path, suffix):
    points = frame()
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
