"""Places where two labellings differ: planted errors, files, pictures, commands."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from prc_cli.core.errors import ConfigError
from prc_cli.core.types import I64
from prc_cli.evaluation.places import (
    Differing,
    ListedPlace,
    PlaceFinder,
    Places,
    best_first,
    place_rows,
)
from prc_cli.jobs.evaluate import evaluate_all
from prc_cli.jobs.evaluate.options import EvaluateOptions
from tests.clouds import write_las
from tests.jobs.evaluate.test_registered import Town

NAMES = ("ground", "building", "vegetation")


def planted_errors(town: Town, n: int) -> tuple[I64, I64]:
    """Return the codes of a CAR with spheres of wrong classes, and the sphere of every point."""
    random = np.random.default_rng(11)
    codes = town.codes.copy()
    sphere = np.full(len(codes), -1)
    tree = cKDTree(town.xyz)
    swapped = {2: 6, 6: 2, 65: 6}
    is_free = np.isin(town.codes, list(swapped))
    for k in range(n):
        middle = int(random.choice(np.flatnonzero(is_free)))
        is_free[tree.query_ball_point(town.xyz[middle], 4.0)] = False
        near = np.array(tree.query_ball_point(town.xyz[middle], random.uniform(0.5, 1.5)))
        near = near[(town.codes[near] == town.codes[middle]) & (sphere[near] < 0)]
        codes[near] = swapped[int(town.codes[middle])]
        sphere[near] = k
    return codes, sphere


@pytest.mark.parametrize("is_shuffled", [False, True], ids=["order", "nearest"])
def test_planted_errors_of_a_car_are_listed_first(tmp_path, *, is_shuffled):
    town = Town()
    codes, sphere = planted_errors(town, 40)
    order = np.arange(len(codes))
    if is_shuffled:
        order = np.random.default_rng(3).permutation(np.flatnonzero(town.codes != 7))
    run = write_las(tmp_path / "run.las", town.xyz, town.labels)
    car = write_las(tmp_path / "car.las", town.xyz[order], codes[order])
    options = EvaluateOptions(match="nearest" if is_shuffled else "order", places=True)
    places = evaluate_all([run], [car], "street", options=options).places
    assert places is not None
    spheres = [int(sphere[item.place.record]) for item in places.places]
    large = {k for k in range(40) if np.count_nonzero(sphere == k) > 50}
    assert len(large.intersection(spheres)) >= 0.9 * len(large) > 20
    assert sum(k >= 0 for k in spheres[:20]) >= 14
    sizes = [item.place.n_records for item in places.places]
    assert sizes == sorted(sizes, reverse=True)
    assert places.n_listed <= places.n_differ


def differing(n: int, seed: int = 1) -> Differing:
    """Return records of two large blobs and of scattered points."""
    random = np.random.default_rng(seed)
    blob = random.normal(0, 0.5, (n, 3)) + np.where(random.random((n, 1)) < 0.5, 0.0, 30.0)
    stray = random.uniform(-500, 500, (n, 3))
    xyz = np.concatenate([blob, stray])
    record = np.arange(2 * n)
    return Differing(
        pair=np.full(2 * n, 1),
        confidence=np.full(2 * n, 90),
        reason=np.full(2 * n, 3),
        records={"file": np.zeros_like(record), "row": record, "line": record, "column": record},
        places={"x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2], "time": record / 7.0},
    )


def test_places_do_not_depend_on_chunks(monkeypatch):
    records = differing(3000)
    lists = []
    for size in (6000, 700, 61):
        monkeypatch.setattr("prc_cli.evaluation.places._MAX_UNMERGED", size)
        finder = PlaceFinder(in_space=True)
        for first in range(0, 6000, size):
            finder.add(records.part(slice(first, first + size)))
        assert finder.n_differ == 6000
        lists.append(best_first(finder.places(NAMES, NAMES)))
    assert lists[0] == lists[1] == lists[2]
    assert [place.n_records > 1300 for place in lists[0]] == [True, True]
    assert lists[0][0].reference == "ground"
    assert lists[0][0].predicted == "building"
    assert lists[0][0].reason == 3


def test_large_places_survive_when_memory_is_full(monkeypatch):
    monkeypatch.setattr("prc_cli.evaluation.places.MAX_CELLS", 1000)
    monkeypatch.setattr("prc_cli.evaluation.places._MAX_UNMERGED", 500)
    finder = PlaceFinder(in_space=True)
    records = differing(20_000)
    for first in range(0, 40_000, 1000):
        finder.add(records.part(slice(first, first + 1000)))
    places = best_first(finder.places(NAMES, NAMES))
    assert len(places) == 2
    assert sum(place.n_records for place in places) > 0.95 * 20_000


def test_lines_and_columns_make_places_of_one_file_each():
    line, column = (part.ravel() for part in np.mgrid[0:6, 0:40])
    record = np.arange(240)
    values = {
        "file": (line >= 3).astype(np.int64),
        "row": record,
        "line": line,
        "column": column,
    }
    unknown = {name: np.full(240, np.nan) for name in ("x", "y", "z", "time")}
    finder = PlaceFinder(in_space=False)
    finder.add(Differing(np.full(240, 5), np.full(240, -1), np.zeros(240, int), values, unknown))
    places = finder.places(NAMES, NAMES)
    assert [(place.file, place.n_records) for place in places] == [(0, 120), (1, 120)]
    assert [(place.first_line, place.last_line) for place in places] == [(0, 2), (3, 5)]
    assert places[0].confidence is None
    row = place_rows(Places((ListedPlace(places[0], "a.las", "a rule", "prc"),), 7, None))[0]
    assert (row["x"], row["length_m"], row["reason"]) == (None, None, None)


def test_labels_alone_have_places_by_line_and_pictures(tmp_path):
    codes = np.full((60, 80), 2, np.uint8)
    codes[:, 40:] = 6
    reference = codes.copy()
    reference[20:30, 50:60] = 5
    np.save(tmp_path / "a.npy", codes.ravel())
    np.save(tmp_path / "b.npy", reference.ravel())
    options = EvaluateOptions(places=True, place_pictures=True, points_per_line=80)
    files = [tmp_path / "a.npy"], [tmp_path / "b.npy"]
    places = evaluate_all(*files, "prc", options=options).places
    assert places is not None
    (item,) = places.places
    assert (item.place.predicted, item.place.reference) == ("building", "vegetation")
    assert (item.place.n_records, item.place.first_line, item.place.last_line) == (100, 20, 29)
    assert item.command.startswith("prc explain INPUT --at 2")
    assert [picture[:4] for picture in places.pictures] == [b"\x89PNG"]
    with pytest.raises(ConfigError, match="no scan lines"):
        evaluate_all(*files, "prc", options=EvaluateOptions(places=True))
