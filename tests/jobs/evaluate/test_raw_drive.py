"""A raw drive whose shots get coordinates from poses: evaluated against, and transferred to, registered points."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.formats.trajectory import read_turns
from tests.runner import runner

LINES, M = 60, 91
ANGLE_DEG = np.linspace(-90, 90, M)
MOUNT = "3,25,-10,0.5,-0.2,0.4"


def turn(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Yaw after pitch after roll, written out."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in np.deg2rad([roll, pitch, yaw]))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive through nowhere: ranges, labels, poses at every line, and the same shots registered."""
    folder = tmp_path_factory.mktemp("raw")
    random = np.random.default_rng(3)
    range_m = random.uniform(2, 30, (LINES, M)).astype(np.float32)
    range_m[random.random((LINES, M)) < 0.1] = np.nan
    time_s = np.repeat(np.arange(LINES) * 0.02, M).reshape(LINES, M)
    codes = np.where(np.isnan(range_m), 0, random.choice([2, 6, 5], (LINES, M))).astype(np.uint8)
    np.savez(folder / "drive.npz", range_m=range_m, time_s=time_s, angle_deg=ANGLE_DEG)
    np.save(folder / "labels.npy", codes)
    angles = [(0.1 * k, 5 - 0.2 * k, 170 + 2 * k) for k in range(LINES)]
    places = [(1000 + 0.4 * k, 2000 + 0.1 * k, 50 + 0.01 * k) for k in range(LINES)]
    rows = [(0.02 * k, *places[k], *angles[k]) for k in range(LINES)]
    head = "time,x,y,z,roll,pitch,yaw"
    np.savetxt(folder / "poses.csv", rows, "%.6f", ",", header=head, comments="")
    by_compass = [(t, x, y, z, r, -p, (90 - w) % 360) for t, x, y, z, r, p, w in rows]
    np.savetxt(folder / "compass.csv", by_compass, "%.6f", ",", header=head.replace("yaw", "heading"), comments="")
    np.savetxt(folder / "positions.csv", [row[:4] for row in rows], "%.6f", ",", header=head[:10], comments="")
    np.savetxt(folder / "bare.csv", [row[:4] for row in rows], "%.6f", ",")
    beam = np.stack([np.zeros(M), np.sin(np.deg2rad(ANGLE_DEG)), -np.cos(np.deg2rad(ANGLE_DEG))])
    mounted = turn(3, 25, -10) @ beam
    xyz = np.concatenate(
        [places[k] + (turn(*angles[k]) @ (mounted * range_m[k] + [[0.5], [-0.2], [0.4]])).T for k in range(LINES)]
    )
    kept = random.permutation(np.flatnonzero(np.isfinite(xyz).all(axis=1)))
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.header.scales = np.full(3, 0.001)
    las.x, las.y, las.z = xyz[kept].T
    las.classification = codes.ravel()[kept]
    las.write(folder / "registered.laz")
    return folder


def evaluate(drive: Path, *arguments: str, poses: str = "poses.csv") -> Any:
    command = ["evaluate", str(drive / "labels.npy"), str(drive / "registered.laz"), "--match", "nearest", "--json"]
    command += ["--predicted-points", str(drive / "drive.npz"), "--trajectory", str(drive / poses), "--mapping", "prc"]
    return runner().invoke(cli, [*command, *arguments])


@pytest.mark.parametrize("poses", ["poses.csv", "compass.csv"])
def test_every_shot_finds_its_own_point(drive: Path, poses: str) -> None:
    done = evaluate(drive, "--mount", MOUNT, "--max-distance", "0.01", poses=poses)
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    n = int(np.isfinite(np.load(drive / "drive.npz")["range_m"]).sum())
    assert found["match"]["n_matched"] == n
    assert found["classes"]["ground"]["f1"] == found["classes"]["building"]["f1"] == 1.0


def test_transfer_places_the_shots_too(drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.laz"
    las = laspy.read(drive / "registered.laz")
    truth = np.array(las.classification)
    las.classification[:] = 1
    las.write(tmp_path / "blank.laz")
    command = ["transfer", str(drive / "labels.npy"), str(tmp_path / "blank.laz"), str(out), "--match", "nearest", "-q"]
    command += [
        "--points",
        str(drive / "drive.npz"),
        "--trajectory",
        str(drive / "poses.csv"),
        "--mount",
        MOUNT,
        "--json",
    ]
    done = runner().invoke(cli, command)
    assert done.exit_code == 0, done.output
    np.testing.assert_array_equal(laspy.read(out).classification, truth)
    assert json.loads(done.stdout)["config"]["transfer"]["trajectory"] == "poses.csv"


@pytest.mark.parametrize(
    ("arguments", "poses", "message"),
    [
        (("--mount", "0,25"), "poses.csv", "expected ROLL,PITCH,YAW or ROLL,PITCH,YAW,X,Y,Z"),
        (("--mount", "up"), "poses.csv", "expected numbers with commas"),
        ((), "positions.csv", "no column for roll"),
        ((), "bare.csv", "no column for roll"),
        ((), "missing.csv", "cannot be read"),
        (("--match", "order"), "poses.csv", "give --match nearest"),
    ],
)
def test_what_cannot_place_shots_is_refused(drive: Path, arguments: tuple[str, ...], poses: str, message: str) -> None:
    done = evaluate(drive, *arguments, poses=poses)
    assert done.exit_code in (1, 2)
    assert message in f"{done.output} {done.exception}"


def test_rings_without_azimuths_are_refused(drive: Path, tmp_path: Path) -> None:
    with np.load(drive / "drive.npz") as kept:
        fan = {**kept, "angle_deg": np.linspace(65, 105, M)}
    np.savez(tmp_path / "drive.npz", **fan)
    for name in ("labels.npy", "registered.laz", "poses.csv"):
        (tmp_path / name).symlink_to(drive / name)
    done = evaluate(tmp_path)
    assert done.exit_code == 1
    assert "their azimuths are not known" in f"{done.output} {done.exception}"


def test_a_wrong_mount_is_refused_or_scores_nothing(drive: Path) -> None:
    done = evaluate(drive, "--max-distance", "0.05")
    assert done.exit_code == 1
    assert "found a partner" in f"{done.output} {done.exception}"


def test_sbet_and_csv_of_one_drive_turn_alike(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    for name in ("a.csv", "a.sbet"):
        arguments = ["simulate", "street", str(tmp_path / f"{name}.npz"), "--lines", "6", "--seed", "3", "-q"]
        arguments += ["--set", "frame.crs=EPSG:32635", "--trajectory", str(tmp_path / name)]
        done = runner().invoke(cli, arguments)
        assert done.exit_code == 0, done.output
    one, other = (read_turns(tmp_path / name, "EPSG:32635") for name in ("a.csv", "a.sbet"))
    assert np.abs((one * other).sum(axis=1)).min() > 1 - 1e-12
