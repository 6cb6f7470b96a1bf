"""Matching by order, time, id and position.

The same pairs and matrix as counted one by one; pictures of both.
"""

import io
from collections.abc import Callable, Sequence
from pathlib import Path

import laspy
import numpy as np
import pytest
from PIL import Image

from prc_cli.config import load_config
from prc_cli.core.errors import ConfigError, InputError, PrcError
from prc_cli.core.types import I64, Mask
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate
from prc_cli.evaluation.html import class_colour
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.scores import Evaluation
from prc_cli.jobs.classify import classify
from prc_cli.jobs.convert import convert
from prc_cli.jobs.evaluate import evaluate_all
from prc_cli.jobs.evaluate.counts import _worst
from prc_cli.jobs.evaluate.options import EvaluateOptions
from prc_cli.jobs.evaluate.pictures import class_pictures
from tests.clouds import write_las
from tests.street import angles, street

MAPPING = ClassMapping(
    ignore=[0],
    predicted={"ground": [2], "building": [6], "vegetation": [5]},
    reference={"ground": [2], "building": [6], "vegetation": [5], "other": [65]},
)
M = 100


class Drive:
    """A stream of lines of M shots, every tenth without return, labelled twice."""

    def __init__(self, n_lines: int = 300, seed: int = 7) -> None:
        random = np.random.default_rng(seed)
        n = n_lines * M
        self.n = n
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

    def matrix(self, chosen: Mask | None = None) -> ConfusionMatrix:
        chosen = self.kept if chosen is None else chosen
        return accumulate(
            ConfusionMatrix.empty(MAPPING), self.label[chosen], self.truth[chosen], MAPPING
        )

    def write_labels(self, path: Path) -> Path:
        np.save(path, self.label.astype(np.uint8))
        return path

    def write_points(self, path: Path, **more: I64) -> Path:
        """Write an image with coordinates and times; ``more`` are further columns."""
        named = {"range_m": self.range_m, "time_s": self.time_s, **more}
        images = {name: column.reshape(-1, M) for name, column in named.items()}
        images["range_m"] = np.where(self.missing.reshape(-1, M), np.nan, images["range_m"])
        xyz = np.where(self.missing[:, None], np.nan, self.xyz)
        np.savez(path, xyz=xyz.reshape(-1, M, 3), **images)
        return path

    def tiles(self) -> list[I64]:
        """Kept records by tiles across the drive, each in another order."""
        random = np.random.default_rng(3)
        kept = np.flatnonzero(self.kept)
        side = (self.xyz[kept, 1] > self.xyz[:, 1].mean()).astype(int) + 2 * (
            self.line[kept] > self.line.max() // 2
        )
        return [random.permutation(kept[side == k]) for k in range(4)]

    def write_tiles(self, folder: Path, crs: int | None = None, shift: float = 0.0) -> list[Path]:
        paths = []
        for k, record in enumerate(self.tiles()):
            las = write_las(
                folder / f"tile_{k}.laz",
                self.xyz[record] + shift,
                self.truth[record],
                extra={"record": record},
                gps_time=self.time_s[record],
            )
            paths.append(las if crs is None else with_crs(las, crs))
        return paths


def with_crs(path: Path, crs: int) -> Path:
    """Name the coordinate system in the header of a file."""
    las = laspy.read(path)
    las.header.add_crs(pytest.importorskip("pyproj").CRS.from_epsg(crs))
    las.write(path)
    return path


@pytest.fixture(scope="module")
def drive():
    return Drive()


@pytest.fixture(scope="module")
def folder(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    drive.write_labels(folder / "labels.npy")
    drive.write_points(folder / "raw.npz")
    drive.write_points(folder / "labelled.npz", label=drive.label)
    drive.write_tiles(folder / "tiles")
    return folder


def run(
    predicted: Path | Sequence[Path], reference: Path | Sequence[Path], **options: object
) -> Evaluation:
    sides = [[side] if isinstance(side, Path) else list(side) for side in (predicted, reference)]
    return evaluate_all(*sides, MAPPING, options=EvaluateOptions(**options))  # type: ignore[arg-type]


def assert_same(evaluation: Evaluation, expected: ConfusionMatrix) -> None:
    np.testing.assert_array_equal(evaluation.matrix.counts, expected.counts)
    assert evaluation.matrix.n_ignored == expected.n_ignored


EXACT = {"match": "nearest", "tolerance": 0.001}
"""Coordinates are the same but for the rounding of LAS."""


def by(match: str) -> dict[str, object]:
    return EXACT if match == "nearest" else {"match": match}


@pytest.mark.parametrize("match", ["time", "dimension:record", "nearest"])
def test_labels_alone_against_filtered_and_shuffled_tiles(drive, folder, match):
    evaluation = run(
        folder / "labels.npy", folder / "tiles", **by(match), predicted_points=folder / "raw.npz"
    )
    assert_same(evaluation, drive.matrix())
    n_kept = int(drive.kept.sum())
    assert (evaluation.match.n_predicted, evaluation.match.n_reference) == (drive.n, n_kept)
    assert (evaluation.match.n_matched, evaluation.match.n_reference_matched) == (n_kept, n_kept)
    if match == "nearest":
        assert (
            f"{drive.missing.sum():,} predicted records have no finite coordinates: left out"
            in evaluation.match.notes
        )


def test_parts_by_line_and_range(drive, folder):
    for match in ("time", "nearest"):
        evaluation = run(
            folder / "labelled.npz",
            folder / "tiles",
            **by(match),
            split_lines=100,
            split_range_m=(20.0,),
        )
        assert_same(evaluation, drive.matrix())
        assert [part.name for part in evaluation.splits["lines"]] == [
            "lines 0-99",
            "lines 100-199",
            "lines 200-299",
        ]
        for part in evaluation.splits["lines"]:
            chosen = drive.kept & (drive.line >= part.low) & (drive.line < part.high)
            np.testing.assert_array_equal(part.matrix.counts, drive.matrix(chosen).counts)
        near, far = evaluation.splits["range"]
        assert (near.name, far.name) == ("0-20 m", "from 20 m")
        np.testing.assert_array_equal(
            near.matrix.counts, drive.matrix(drive.kept & (drive.range_m < 20)).counts
        )
        np.testing.assert_array_equal((near.matrix + far.matrix).counts, evaluation.matrix.counts)


def test_returns_of_one_shot_are_told_apart(tmp_path):
    time_s = np.array([1.0, 1.0, 2.0, 2.0, 3.0])
    number = np.array([1, 2, 1, 2, 1])
    codes = np.array([2, 5, 2, 6, 2])
    for name, chosen in (("a", [0, 1, 2, 3, 4]), ("b", [3, 4, 1])):
        write_las(
            tmp_path / f"{name}.las",
            np.zeros((len(chosen), 3)),
            codes[chosen],
            gps_time=time_s[chosen],
            return_number=number[chosen],
        )
    evaluation = run(tmp_path / "a.las", tmp_path / "b.las", match="time")
    assert evaluation.match.n_matched == 3
    assert np.trace(evaluation.matrix.counts[:3]) == 3


@pytest.mark.slow
def test_pairs_of_unknown_range_are_a_part_and_parts_without_scored_pairs_are_left_out(
    drive, folder
):
    np.save(folder / "truth.npy", drive.truth)
    options = {"predicted_points": folder / "raw.npz", "split_range_m": (20.0, 40.0, 99.0)}
    evaluation = run(folder / "labels.npy", folder / "truth.npy", **options)
    names = [part.name for part in evaluation.splits["range"]]
    assert names == ["0-20 m", "20-40 m", "40-99 m"]
    assert (
        sum(part.matrix.n_scored for part in evaluation.splits["range"])
        == evaluation.matrix.n_scored
    )
    # nothing is farther; ranges are unknown of missing shots alone, none of which is scored
    note = (
        f"by range: 2 parts without scored records are left out, with {drive.missing.sum()} "
        "ignored records"
    )
    assert note in evaluation.match.notes
    # a part of their own where they are scored
    truth = np.where(drive.missing, 2, 6).astype(np.uint8)
    np.save(folder / "all.npy", truth)
    evaluation = run(
        folder / "all.npy", folder / "all.npy", **{**options, "split_range_m": (20.0,)}
    )
    assert [part.name for part in evaluation.splits["range"]][-1] == "unknown"
    assert evaluation.splits["range"][-1].matrix.n_scored == drive.missing.sum()


def refused(error: type[PrcError], act: Callable[[], object]) -> str:
    with pytest.raises(error) as caught:
        act()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_poor_matches_are_refused(drive, folder, tmp_path):
    tiles = drive.write_tiles(tmp_path / "far", shift=5000.0)
    message = refused(InputError, lambda: run(folder / "labelled.npz", tiles, match="nearest"))
    assert "nothing overlaps; check that both are registered in one system" in message
    assert "tile_0.laz and 3 more: x 674999.971 to 675029.93" in message
    late = replace_time(tmp_path / "late.las", drive, 1000.0)
    message = refused(InputError, lambda: run(folder / "labelled.npz", late, match="time"))
    assert "time 300000000 to 300000001" in message
    assert "both clocks count alike" in message
    half = replace_time(tmp_path / "half.las", drive, 0.3)
    message = refused(
        InputError, lambda: run(folder / "labelled.npz", half, match="time", min_matched=0.9)
    )
    assert "expected at least 90 %" in message
    assert run(folder / "labelled.npz", half, match="time", min_matched=0.1).match.n_matched > 0


def replace_time(path: Path, drive: Drive, shift_s: float) -> Path:
    return write_las(path, drive.xyz, drive.truth, gps_time=drive.time_s + shift_s)


def test_other_coordinate_systems_are_refused_with_both_names(drive, tmp_path):
    here, there = (drive.write_tiles(tmp_path / str(crs), crs)[:1] for crs in (32635, 3067))
    mapping = ClassMapping(ignore=[0], predicted=MAPPING.reference, reference=MAPPING.reference)

    def act(match: str, predicted: list[Path] = here, reference: list[Path] = there) -> Evaluation:
        return evaluate_all(predicted, reference, mapping, options=EvaluateOptions(match=match))

    message = refused(InputError, lambda: act("nearest"))
    assert "UTM zone 35N" in message
    assert "TM35FIN" in message
    assert act("time").match.n_matched == act("nearest", here, here).match.n_matched > 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    "options, expected",
    [
        (
            {"match": "colour"},
            "found 'colour', expected one of: order, time, dimension:NAME, nearest",
        ),
        ({"tolerance": 1.0}, "records matched by order have none"),
        (
            {"unmatched": "noise"},
            "--unmatched: needs coordinates of both sides, records are matched by order",
        ),
        ({"inside": "0,0,1,1", "match": "time"}, "give --match nearest"),
        (
            {"third": Path("c.npy"), "match": "time"},
            "a third labelling is matched by order or nearest",
        ),
        ({"pool": True}, "records of pooled files have no order"),
        ({"match": "nearest", "tolerance": 0.0}, "expected a finite number above 0"),
        ({"min_matched": 2.0}, "expected a share from 0 to 1"),
        ({"split_range_m": (20.0, 10.0)}, "expected ascending ranges"),
        ({"split_lines": 0}, "expected at least 1"),
        ({"split_confidence": (60, 40)}, "expected rising per cents"),
        ({"split_confidence": (101,)}, "expected rising per cents"),
        ({"match": "time"}, "no 'time' to match by in the file, which has: class codes alone"),
        ({"match": "nearest"}, "no 'x' to match by"),
        ({"match": "dimension:shot"}, "no 'shot' to match by"),
        ({"split_range_m": (20.0,)}, "no range to split by"),
        ({"split_lines": 5}, "give -M, or --points"),
        ({"split_scanner": True}, "no scanner to split by"),
    ],
)
def test_options_that_make_no_sense(folder, options, expected):
    np.save(folder / "same.npy", np.ones(5, np.uint8) * 2)
    act = lambda: run(folder / "same.npy", folder / "same.npy", **options)  # noqa: E731
    assert expected.replace("class codes alone", "") in refused(ConfigError, act)


def test_bad_inputs(drive, folder, tmp_path):
    np.save(tmp_path / "short.npy", drive.label[:-1])
    options = {"match": "time", "predicted_points": folder / "raw.npz"}
    message = refused(InputError, lambda: run(tmp_path / "short.npy", folder / "tiles", **options))
    assert f"{drive.n - 1} class codes" in message
    assert f"holds {drive.n} records" in message
    message = refused(InputError, lambda: run(tmp_path / "short.npy", folder / "labels.npy"))
    assert "matched by order needs equal counts" in message
    (tmp_path / "nan.csv").write_text("time,class\nnan,2\n,2\n")
    message = refused(InputError, lambda: run(tmp_path / "nan.csv", folder / "tiles", match="time"))
    assert "no record has finite time" in message
    (tmp_path / "half.csv").write_text("record,class\n0.5,2\n1,2\n")
    message = refused(
        InputError, lambda: run(tmp_path / "half.csv", folder / "tiles", match="dimension:record")
    )
    assert "expected a whole number below 2^53" in message
    assert "nowhere: no such file" in refused(
        InputError, lambda: run(folder / "tiles", tmp_path / "nowhere")
    )
    message = refused(
        ConfigError, lambda: run([folder / "labels.npy"] * 2, [folder / "labels.npy"])
    )
    assert "2 predicted and 1 reference files" in message
    with pytest.raises(InputError, match="codes that the class mapping does not list: 99"):
        np.save(tmp_path / "odd.npy", np.full(drive.n, 99))
        run(tmp_path / "odd.npy", folder / "tiles", **options)


def test_two_scans_are_not_matched_by_cell(tmp_path):
    """Wherever the lines, the columns or the ranges show it.

    Labels of a part begin at a line that nobody knows.
    """
    config = load_config(preset="prc-2019-urban")
    for name, image in (("a", street()), ("b", street(100)), ("c", 1.5 * street(seed=2))):
        np.savez(tmp_path / f"{name}.npz", range_m=image, angle_deg=np.rad2deg(angles()))
        for suffix in (".npy", ".laz"):
            classify(tmp_path / f"{name}.npz", tmp_path / f"{name}{suffix}", config)
    classify(
        tmp_path / "a.npz",
        tmp_path / "part.npy",
        load_config(options={"input": {"only_lines": "20:120"}}),
    )
    for predicted, reference, message in (
        ("b.npy", "a.laz", "137 lines of 180 shots, but .* has 100 of 180: another scan"),
        ("a.laz", "b.npy", "137 lines of 180 shots, but .* has 100 of 180: another scan"),
        ("a.laz", "c.laz", "shots have other ranges than in .*: another scan"),
        ("part.npy", "a.laz", "matched by order needs equal counts"),
    ):
        with pytest.raises(InputError, match=message):
            evaluate_all([tmp_path / predicted], [tmp_path / reference])


@pytest.mark.slow
@pytest.mark.parametrize(
    "labels, other", [(".npy", ".laz"), (".csv", ".ply"), ("grid.csv", ".laz")]
)
def test_files_of_one_drive_are_matched_by_cell_where_their_numbers_differ(tmp_path, labels, other):
    image = street()
    np.savez(tmp_path / "s.npz", range_m=image, angle_deg=np.rad2deg(angles()))
    config = load_config(preset="prc-2019-urban")
    cloud = tmp_path / f"s{other}"
    left = tmp_path / f"l{labels}"
    classify(tmp_path / "s.npz", cloud, config)
    if labels == "grid.csv":
        convert(cloud, left)
    else:
        classify(tmp_path / "s.npz", left, config)
    for predicted, reference in ((left, cloud), (cloud, left)):
        evaluation = evaluate_all([predicted], [reference])
        assert (evaluation.match.method, evaluation.match.n_matched) == (
            "cell",
            int((~np.isnan(image)).sum()),
        )
        assert evaluation.matrix.counts.trace() == evaluation.matrix.counts.sum() > 0
        assert "matched by cell (scan line, column)" in " ".join(evaluation.match.notes)
    assert evaluate_all([cloud], [cloud]).match.method == "order"


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
