"""Matching by order, time, id and position.

The same pairs and matrix as counted one by one; pictures of both.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from prc_cli.core.errors import ConfigError
from prc_cli.core.types import Mask
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate
from prc_cli.evaluation.html import class_colour
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.scores import Evaluation
from prc_cli.jobs.evaluate import evaluate_all
from prc_cli.jobs.evaluate.counts import _worst
from prc_cli.jobs.evaluate.options import EvaluateOptions, check_options
from prc_cli.jobs.evaluate.pictures import class_pictures
from tests.clouds import write_las

MAPPING = ClassMapping(
    ignore=[0],
    predicted={"ground": [2], "building": [6], "vegetation": [5]},
    reference={"ground": [2], "building": [6], "vegetation": [5], "other": [65]},
)
M = 100


class Drive:
    """A stream of lines of M shots, every tenth without return, labelled twice."""

    def __init__(self) -> None:
        random = np.random.default_rng(7)
        n = 300 * M
        self.time_s = 3.0e8 + np.arange(n) * 2e-5
        self.line = np.arange(n) // M
        self.range_m = random.uniform(2.0, 60.0, n)
        self.xyz = np.stack(
            [6.7e5 + self.line * 0.1, 6.2e6 + (np.arange(n) % M) * 0.1, np.full(n, 40.0)], axis=1
        )
        self.xyz += random.uniform(-0.03, 0.03, (n, 3))
        self.truth = random.choice([2, 5, 6, 65], n)
        self.label = np.where(random.random(n) < 0.8, np.where(self.truth == 65, 6, self.truth), 5)
        self.missing = random.random(n) < 0.1
        self.truth[self.missing] = self.label[self.missing] = 0
        self.kept = ~self.missing & (random.random(n) < 0.8)

    def matrix(self, chosen: Mask) -> ConfusionMatrix:
        return accumulate(
            ConfusionMatrix.empty(MAPPING), self.label[chosen], self.truth[chosen], MAPPING
        )

    def write_points(self, path: Path) -> None:
        """Write an image with coordinates and times."""
        images = {
            "range_m": np.where(self.missing, np.nan, self.range_m),
            "time_s": self.time_s,
            "label": self.label,
        }
        xyz = np.where(self.missing[:, None], np.nan, self.xyz).reshape(-1, M, 3)
        np.savez(path, xyz=xyz, **{name: image.reshape(-1, M) for name, image in images.items()})

    def write_tiles(self, folder: Path) -> None:
        """Write kept records by tiles across the drive, each in another order."""
        random = np.random.default_rng(3)
        kept = np.flatnonzero(self.kept)
        side = (self.xyz[kept, 1] > self.xyz[:, 1].mean()) + 2 * (self.line[kept] > 150)
        for k in range(4):
            record = random.permutation(kept[side == k])
            write_las(
                folder / f"tile_{k}.laz",
                self.xyz[record],
                self.truth[record],
                extra={"record": record},
                gps_time=self.time_s[record],
            )


@pytest.fixture(scope="module")
def drive():
    return Drive()


@pytest.fixture(scope="module")
def folder(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    np.save(folder / "labels.npy", drive.label.astype(np.uint8))
    drive.write_points(folder / "drive.npz")
    drive.write_tiles(folder / "tiles")
    return folder


def run(predicted: Path, reference: Path, **options: Any) -> Evaluation:
    return evaluate_all([predicted], [reference], MAPPING, options=EvaluateOptions(**options))


def assert_same(matrix: ConfusionMatrix, expected: ConfusionMatrix) -> None:
    np.testing.assert_array_equal(matrix.counts, expected.counts)
    assert matrix.n_ignored == expected.n_ignored


# coordinates are the same but for the rounding of LAS
MATCHES = pytest.mark.parametrize(
    "match, tolerance", [("time", None), ("dimension:record", None), ("nearest", 0.001)]
)


@MATCHES
def test_labels_alone_against_filtered_and_shuffled_tiles(drive, folder, match, tolerance):
    evaluation = run(
        folder / "labels.npy",
        folder / "tiles",
        match=match,
        tolerance=tolerance,
        predicted_points=folder / "drive.npz",
    )
    assert_same(evaluation.matrix, drive.matrix(drive.kept))
    pairs = evaluation.match
    n_kept = int(drive.kept.sum())
    assert (pairs.n_predicted, pairs.n_reference) == (len(drive.label), n_kept)
    assert (pairs.n_matched, pairs.n_reference_matched) == (n_kept, n_kept)
    if match == "nearest":
        note = f"{drive.missing.sum():,} predicted records have no finite coordinates: left out"
        assert note in pairs.notes


@MATCHES
def test_parts_by_line_and_range(drive, folder, match, tolerance):
    evaluation = run(
        folder / "drive.npz",
        folder / "tiles",
        match=match,
        tolerance=tolerance,
        split_lines=100,
        split_range_m=(20.0,),
    )
    is_near = drive.range_m < 20
    expected = {f"lines {low}-{low + 99}": drive.line // 100 == low // 100 for low in (0, 100, 200)}
    expected |= {"0-20 m": is_near, "from 20 m": ~is_near}
    parts = [*evaluation.splits["lines"], *evaluation.splits["range"]]
    assert [part.name for part in parts] == list(expected)
    for part in parts:
        assert_same(part.matrix, drive.matrix(drive.kept & expected[part.name]))


@pytest.mark.parametrize(
    "options, expected",
    [
        ({"min_matched": 2.0}, "min_matched: found 2, expected a share from 0 to 1"),
        ({"split_range_m": (20.0, 10.0)}, "split by range: .* expected ascending ranges"),
        ({"split_lines": 0}, "split_lines: found 0, expected at least 1"),
        ({"split_confidence": (60, 40)}, "expected rising per cents"),
        ({"split_confidence": (101,)}, "expected rising per cents"),
    ],
)
def test_options_that_no_command_would_give(options, expected):
    with pytest.raises(ConfigError, match=expected):
        check_options(EvaluateOptions(**options))


GROUND_CAR = ClassMapping(
    ignore=(0,), predicted={"ground": (2,), "noise": (7,)}, reference={"car": (65,), "ground": (2,)}
)
GREY = (222, 222, 222)
WHITE = (255, 255, 255)


def colour(name: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(class_colour(name)[1:]))


def draw(
    tmp_path: Path,
    predicted: object,
    reference: object,
    m: int,
) -> list[tuple[str, np.ndarray]]:
    paths = tmp_path / "predicted.npy", tmp_path / "reference.npy"
    for path, codes in zip(paths, (predicted, reference), strict=True):
        np.save(path, np.asarray(codes, np.uint8))
    pictures = class_pictures(*paths, GROUND_CAR, m)
    return [
        (title, np.asarray(Image.open(io.BytesIO(content)).convert("RGB")))
        for title, content in pictures
    ]


def test_cells_have_the_colours_of_their_classes(tmp_path):
    # three lines of two shots; records of an unfinished line are left out
    (title, first), (_, second), (_, differ) = draw(
        tmp_path, [2, 7, 2, 2, 0, 2, 2], [2, 2, 65, 0, 2, 2, 2], 2
    )
    assert title == "Predicted, lines 0-2 of predicted.npy"
    assert first.shape == second.shape == differ.shape
    rows = np.array([0, -1])
    columns = np.array([0, first.shape[1] // 2, -1])
    cells = [
        [[tuple(image[r, c].tolist()) for c in columns] for r in rows]
        for image in (first, second, differ)
    ]
    ground = colour("ground")
    noise = colour("noise")
    car = colour("car")
    assert cells[0] == [[ground, ground, WHITE], [noise, ground, ground]]
    assert cells[1] == [[ground, car, ground], [ground, WHITE, ground]]
    assert cells[2] == [[GREY, ground, WHITE], [noise, WHITE, GREY]]
    assert _worst(np.array([[0, 0, 0], [3, 2, 1], [1, 0, 2]])).tolist() == [0, 1, 3]


@pytest.mark.parametrize("rising", [True, False])
def test_the_sky_is_at_the_top_whichever_way_the_columns_run(tmp_path, *, rising):
    m = 60
    n = 40
    beam = np.deg2rad(np.linspace(20, 120, m))
    beam = beam if rising else beam[::-1]
    # a scanner 2 m over the ground, and a wall 15 m away
    range_m = np.minimum(2.0 / np.maximum(np.cos(beam), 0.01), 15.0 / np.sin(beam))
    x = range_m * np.sin(beam)
    z = -range_m * np.cos(beam)
    line, column = (cell.ravel() for cell in np.mgrid[0:n, 0:m])
    table = np.stack([range_m[column], x[column], 0.01 * line, z[column], line, column], axis=1)
    points = tmp_path / "points.csv"
    names = "range,x,y,z,scan_line,column"
    np.savetxt(points, table, "%.4f", ",", header=names, comments="")
    codes = np.tile(np.where(z < -1.99, 2, 7), n).astype(np.uint8)
    np.save(tmp_path / "labels.npy", codes)
    pair = tmp_path / "labels.npy", tmp_path / "labels.npy"
    mapping = ClassMapping(
        predicted={"ground": (2,), "noise": (7,)}, reference={"ground": (2,), "noise": (7,)}
    )
    pictures = class_pictures(*pair, mapping, m, points=(points, None))
    image = np.asarray(Image.open(io.BytesIO(pictures[0][1])).convert("RGB"))
    assert tuple(image[0, 0].tolist()) == colour("noise")
    assert tuple(image[-1, 0].tolist()) == colour("ground")
