"""Real scans through the functions of the commands."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.errors import InputError, OrderError
from prc_cli.evaluation.scores import gate_value, scores
from prc_cli.jobs.classify import classify
from prc_cli.jobs.evaluate import evaluate
from prc_cli.jobs.info import inspect

pytestmark = [pytest.mark.slow, pytest.mark.data]

ROOT = Path(__file__).resolve().parent.parent


def options(**inputs: object) -> LoadedConfig:
    return load_config(preset="prc-2019-urban", options={"input": inputs})


# lower bounds a little under what is measured (docs/accuracy.md): a change that loses accuracy must
# be seen
@pytest.mark.parametrize(
    ("strip", "published_ground", "ground", "vegetation", "building"),
    [(1, 0.93, 0.94, 0.51, 0.70), (2, 0.94, 0.95, 0.76, 0.67), (3, 0.94, 0.95, 0.76, None)],
)
def test_oakland(
    real_data: Path,
    tmp_path: Path,
    strip: int,
    published_ground: float,
    ground: float,
    vegetation: float,
    building: float | None,
) -> None:
    source = real_data / "oakland" / f"oakland_{strip}.csv.gz"
    classify(source, tmp_path / "urban.npy", load_config(preset="prc-2019-urban"))
    oakland_scores = scores(evaluate(tmp_path / "urban.npy", source, "oakland"))
    assert gate_value(oakland_scores, "f1.ground") > published_ground
    classify(
        source, tmp_path / "sick.npy", load_config(ROOT / "sample_configs" / "sick_push_broom.toml")
    )
    oakland_scores = scores(evaluate(tmp_path / "sick.npy", source, "oakland"))
    assert gate_value(oakland_scores, "f1.ground") > ground
    assert gate_value(oakland_scores, "f1.vegetation") > vegetation
    if building is not None:  # the third strip has no building
        assert gate_value(oakland_scores, "f1.building") > building


def origin_above(las: laspy.LasData, height_m: float) -> str:
    """Return a scanner position over the middle of a cloud, as a static scan would have it."""
    x, y, z = (np.asarray(axis, np.float64) for axis in (las.x, las.y, las.z))
    return f"origin:{x.mean():.2f},{y.mean():.2f},{z.max() + height_m:.2f}"


def assert_only_classes_differ(before: Path, after: Path) -> None:
    old = laspy.read(before)
    new = laspy.read(after)
    assert old.header.point_format == new.header.point_format
    assert np.array_equal(old.header.scales, new.header.scales)
    assert np.array_equal(old.header.offsets, new.header.offsets)
    for name in old.point_format.dimension_names:
        if name != "classification":
            assert np.array_equal(old[name], new[name]), name
    assert len(np.unique(new.classification)) > 1


def test_airborne_strip(real_data: Path, tmp_path: Path) -> None:
    source = real_data / "las" / "als_strip_labelled.laz"
    las = laspy.read(source)
    # after a stray start of 661 records the times span 909.1 periods of 150 Hz; 843 jumps exceed 2
    # degrees, the other lines are the short ones where the edge of the flight is cut
    time_s = np.asarray(las.gps_time)[661:]
    n_lines = 1 + int(np.ceil(np.ptp(time_s) * 150))
    assert n_lines == 911
    assert np.count_nonzero(np.diff(np.asarray(las.scan_angle) * 0.006) > 2) == 843
    setup = inspect(source, load_config())
    assert setup.facts is not None
    assert setup.facts.n_lines == n_lines
    json.dumps(setup.as_dict(), allow_nan=False)
    with pytest.raises(InputError, match="no ranges"):
        classify(source, tmp_path / "out.laz", options(order="trust"))
    assert list(tmp_path.iterdir()) == []
    origin = origin_above(las, 1000.0)
    with pytest.raises(OrderError, match="gps_time decreases in 3 of"):  # the stray start
        classify(source, tmp_path / "out.laz", options(range=origin))
    summary = classify(source, tmp_path / "out.laz", options(range=origin, order="trust"))
    assert summary.counts.n_lines == n_lines
    assert_only_classes_differ(source, tmp_path / "out.laz")


@pytest.mark.parametrize("name", ["mls_not_in_time_order.las", "ign_tile_not_chronological.laz"])
def test_unordered_files_are_refused_with_the_evidence(
    real_data: Path, tmp_path: Path, name: str
) -> None:
    source = real_data / "las" / name
    inputs = {"lines": "fixed", "points_per_line": 500, "range": "origin:0,0,0"}
    with pytest.raises(OrderError, match="gps_time decreases in [0-9.]+ % of") as caught:
        classify(source, tmp_path / "out.las", options(**inputs))
    assert caught.value.exit_code == 1
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
    assert "not in the order" in inspect(source, options(**inputs)).problem
