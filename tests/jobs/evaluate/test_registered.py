"""A registered reference: its area, heights, trees and noise, what is wrong with it, a third
labelling, raw drives."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.reports import as_dict
from prc_cli.evaluation.scores import Evaluation
from prc_cli.jobs.evaluate import evaluate_all
from prc_cli.jobs.evaluate.options import EvaluateOptions
from tests.clouds import write_las
from tests.runner import runner

CODES = {"noise": (7,), "ground": (2,), "building": (6,), "stem": (64,), "car": (65,)}
MAPPING = ClassMapping(predicted=CODES, reference=CODES, coarser={"car": "building"})


class Town:
    """A street of 100 m with a wall, a post and noise in the air; every point once."""

    def __init__(self) -> None:
        random = np.random.default_rng(5)
        ground = random.uniform(0, 1, (60_000, 3)) * [100, 20, 0.005]
        wall = random.uniform(0, 1, (30_000, 3)) * [100, 0.005, 6] + [0, 20, 0]
        post = random.uniform(-1, 1, (3_000, 3)) * [0.1, 0.1, 2] + [50.5, 10, 2]
        cubes = [
            random.uniform(0, 1, (1_500, 3)) * [0.5, 0.5, 2] + [x, 4, 0] for x in (20, 43, 71, 90)
        ]
        noise = random.uniform(0, 1, (4_000, 3)) * [100, 18, 8] + [0, 1, 1]
        parts = [ground, wall, post, *cubes, noise]
        self.xyz = np.concatenate(parts)
        self.codes = np.repeat([2, 6, 64, 65, 65, 65, 65, 7], [len(part) for part in parts])
        self.error = random.normal(0, 0.004, self.xyz.shape)
        # of the noise, four in five are found; of the ground, one in a hundred is called noise
        has_return = random.random(len(self.codes))
        self.labels = np.where((self.codes == 7) & (has_return > 0.8), 6, self.codes)
        self.labels[(self.codes == 2) & (has_return < 0.01)] = 7


@pytest.fixture(scope="module")
def town():
    return Town()


@pytest.fixture(scope="module")
def folder(town, tmp_path_factory):
    folder = tmp_path_factory.mktemp("town")
    write_las(folder / "run.las", town.xyz, town.labels)
    xyz = town.xyz + town.error
    for k in range(4):  # tiles of 25 m: shuffled, without noise, half of the points
        inside = (xyz[:, 0] // 25 == k) & (town.codes != 7)
        mine = np.random.default_rng(k).permutation(np.flatnonzero(inside))[::2]
        write_las(folder / f"tiles/tile_{k}.laz", xyz[mine], town.codes[mine])
    return folder


def run(folder: Path, **options: Any) -> Evaluation:
    sides = [folder / "run.las"], [folder / "tiles"]
    return evaluate_all(*sides, MAPPING, options=EvaluateOptions(match="nearest", **options))


def noted(evaluation: Evaluation, text: str) -> str:
    return next((note for note in evaluation.match.notes if text in note), "")


@pytest.mark.slow
def test_noise_is_what_the_reference_lacks(town, folder):
    noise = town.codes == 7
    said = town.labels == 7
    true = (noise & said).sum() / noise.sum(), (noise & said).sum() / said.sum()
    for area in (None, "0,0,100,21"):
        evaluation = run(folder, unmatched="noise", tolerance=0.5, inside=area)
        item = as_dict(evaluation)["classes"]["noise"]
        assert (item["recall"], item["precision"]) == pytest.approx(true, abs=0.02)
        assert noted(evaluation, "have no partner within 0.5 m: noise in the reference")
    text = noted(run(folder, unmatched="noise"), "noise close to the reference")
    estimate = re.findall(r"(?:noise recall|precision) ([.\d]+)", text)
    assert [float(number) for number in estimate] == pytest.approx(true, abs=0.02)
    assert not noted(run(folder, unmatched="noise", tolerance=0.02), "noise close to the reference")
    left = run(folder, tolerance=0.5)
    assert as_dict(left)["classes"]["noise"]["n_reference"] == 0
    assert noted(left, "--unmatched noise counts them as noise")
    chosen = run(folder)
    assert 0.01 < (chosen.match.tolerance or 0) < 0.4
    assert noted(chosen, "median distance of the clouds")


LINES = 60
M = 91
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
def drive(tmp_path_factory):
    """A drive through nowhere: ranges, labels, poses at every line, and the same shots
    registered."""
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
    by_compass = [(t, x, y, z, r, -p, (90 - w) % 360) for t, x, y, z, r, p, w in rows]
    for name, table, named in (
        ("poses", rows, head),
        ("compass", by_compass, head.replace("yaw", "heading")),
        ("positions", [row[:4] for row in rows], head[:10]),
    ):
        np.savetxt(folder / f"{name}.csv", table, "%.6f", ",", header=named, comments="")
    beam = np.stack([np.zeros(M), np.sin(np.deg2rad(ANGLE_DEG)), -np.cos(np.deg2rad(ANGLE_DEG))])
    mounted = turn(3, 25, -10) @ beam
    xyz = np.concatenate(
        [
            places[k] + (turn(*angles[k]) @ (mounted * range_m[k] + [[0.5], [-0.2], [0.4]])).T
            for k in range(LINES)
        ]
    )
    kept = random.permutation(np.flatnonzero(np.isfinite(xyz).all(axis=1)))
    write_las(folder / "registered.laz", xyz[kept], codes.ravel()[kept])
    return folder


def evaluate(drive: Path, *arguments: str, poses: str = "poses.csv") -> Any:
    command = f"evaluate {drive}/labels.npy {drive}/registered.laz --match nearest --json"
    command += f" --points {drive}/drive.npz --trajectory {drive}/{poses} --mapping prc"
    return runner().invoke(cli, [*command.split(), *arguments])


@pytest.mark.parametrize("poses", ["poses.csv", "compass.csv"])
def test_every_shot_finds_its_own_point(drive, poses):
    done = evaluate(drive, "--mount", MOUNT, "--max-distance", "0.01", poses=poses)
    assert done.exit_code == 0, done.output
    scores = json.loads(done.stdout)
    n = int(np.isfinite(np.load(drive / "drive.npz")["range_m"]).sum())
    assert scores["match"]["n_matched"] == n
    assert scores["classes"]["ground"]["f1"] == scores["classes"]["building"]["f1"] == 1.0


@pytest.mark.slow
def test_areas_heights_and_trees_choose_the_points_that_lie_in_them(town, folder, tmp_path):
    x, y = np.round(town.xyz[:, :2].T, 3)
    inside = (x >= 10) & (x <= 30) & (y >= 0) & (y <= 12)
    area = run(folder, inside="10,0,30,12", unmatched="noise", tolerance=0.3)
    assert area.match.n_predicted == len(x)
    assert area.matrix.n_scored == pytest.approx(inside.sum(), abs=3)
    (tmp_path / "trees.csv").write_text("x,y,radius,height\n50.5,10,0.4,2\n20.25,4.25,0.5,9\n")
    for options, name, n in (
        # the wall is 6 m high
        ({"height": (1.0, 3.0)}, "building", 30_000 / 3),
        # the post is one, and a block of 2 m stands in the other cylinder, which begins at 0.3 m
        ({"trees": tmp_path / "trees.csv"}, "stem", 3_000 + 1_500 * 1.7 / 2),
    ):
        matrix = run(folder, tolerance=0.3, **options).matrix
        rows = dict(zip(matrix.reference_names, matrix.counts.sum(axis=1), strict=True))
        assert rows[name] == pytest.approx(n, rel=0.05)


@pytest.mark.parametrize("match, tolerance", [("nearest", 0.001), ("order", None)])
def test_three_labellings_are_counted_shot_by_shot(town, folder, tmp_path, match, tolerance):
    third = np.where(town.codes == 65, 6, town.codes)
    truth = write_las(tmp_path / "truth.las", town.xyz, town.codes)
    path = write_las(tmp_path / "third.las", town.xyz, third)
    options = EvaluateOptions(match=match, third=path, tolerance=tolerance)
    three = evaluate_all([folder / "run.las"], [truth], MAPPING, options=options).three
    right = town.labels == town.codes
    states = three.states()
    assert states["both right"] == (right & (third == town.codes)).sum()
    assert states["only predicted right"] == (right & (third != town.codes)).sum()
    assert states["only third right"] == (~right & (third == town.codes)).sum()
