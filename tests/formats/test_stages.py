"""``[output] stages``: intermediate results of the sequential-angle classifier, in every output
format."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.core.classes import Surface
from prc_cli.core.stream import LabelledBlock, StageLabels
from prc_cli.formats.writing.columns import OutputConfig
from tests.formats.common import URBAN, labelled, random_labels, write
from tests.formats.las.lasbytes import make_las, parse

SOURCE = Path("drive.bin")
LINES = 15
M = 20
N = LINES * M
STAGES = OutputConfig(stages=True)
Stages = dict[str, np.ndarray]
NOTICE = "output.stages needs the fused, prc or sequential-angle method; nothing was added"


def drive(order: np.ndarray, *, has_stages: bool = True) -> tuple[list[LabelledBlock], Stages]:
    """Return blocks of four lines, and their stages; ``order`` is the record of every cell."""
    rng = np.random.default_rng(3)
    shape = (LINES, M)
    labels = random_labels(N, URBAN, 3).reshape(shape)
    height = np.repeat(rng.normal(-1.8, 0.1, (LINES, 1)), M, axis=1).astype(np.float32)
    height[5] = np.nan
    dense = rng.random(shape) < 0.4
    stages = {
        "surface": rng.integers(0, 5, shape, dtype=np.uint8),
        "dense_vegetation": dense,
        "ground_height": height,
        "trigger": rng.integers(0, 4, shape, dtype=np.uint8),
        "car_interval": rng.integers(0, 1 << 16, shape, dtype=np.uint16),
        "car_test": rng.integers(0, 7, shape, dtype=np.uint8),
    }
    car_surface = np.where(dense, Surface.VEGETATION, Surface.HORIZONTAL).astype(np.uint8)
    blocks = []
    for first in range(0, LINES, 4):
        rows = slice(first, first + 4)
        columns = {**stages, "dense_vegetation": car_surface}.values()
        kept = StageLabels(*(column[rows] for column in columns)) if has_stages else None
        record = order.reshape(shape)[rows]
        blocks.append(labelled(labels[rows], first_line=first, record=record, stages=kept))
    return blocks, stages


def same_bits(actual: np.ndarray, expected: np.ndarray) -> bool:
    return np.array_equal(
        np.asarray(actual, np.float32).view("u4"), np.asarray(expected, np.float32).view("u4")
    )


@pytest.mark.parametrize("extra", [False, True])
@pytest.mark.parametrize(
    ("form", "before", "after"), [(1, ".las", ".laz"), (3, ".laz", ".las"), (6, ".laz", ".laz")]
)
def test_rewritten_files_hold_them(
    tmp_path: Path,
    form: int,
    before: str,
    after: str,
    extra: bool,
) -> None:
    source = tmp_path / f"in{before}"
    output = tmp_path / f"out{after}"
    make_las(source, form, extra=extra)
    order = np.random.default_rng(8).permutation(N)
    blocks, stages = drive(order)
    write(output, source, blocks, options=STAGES)
    old = laspy.read(source)
    new = laspy.read(output)
    assert list(new.point_format.extra_dimension_names) == [
        *old.point_format.extra_dimension_names,
        *stages,
    ]
    for name, expected in stages.items():
        assert same_bits(new[name][order], expected.ravel())
    for name in old.point_format.dimension_names:
        if name != "classification":
            assert np.asarray(old[name]).tobytes() == np.asarray(new[name]).tobytes()


@pytest.mark.parametrize("suffix", [".las", ".laz", ".csv", ".parquet", ".npy"])
@pytest.mark.parametrize("rewritten", [False, True])
def test_a_method_without_stages_adds_nothing(tmp_path: Path, suffix: str, rewritten: bool) -> None:
    """The output is that of a run without the option, byte for byte but for the run record's
    notice."""
    source = SOURCE
    if rewritten:
        source = tmp_path / "in.las"
        make_las(source, 6)
    blocks, _ = drive(np.arange(N), has_stages=False)
    record = write(tmp_path / f"asked{suffix}", source, blocks, options=STAGES)
    write(tmp_path / f"plain{suffix}", source, blocks)
    if suffix == ".npy":
        needs = "a .npy output holds class codes only; stages need .csv, .parquet, .las or .laz"
        assert record.notices == (needs,)
    else:
        assert [text for text in record.notices if "stages" in text] == [NOTICE]
    if suffix in (".las", ".laz"):
        asked = parse(tmp_path / f"asked{suffix}")
        plain = parse(tmp_path / f"plain{suffix}")
        assert np.array_equal(asked.records, plain.records)
        assert asked.kept_vlrs() == plain.kept_vlrs()
    else:
        assert (tmp_path / f"asked{suffix}").read_bytes() == (
            tmp_path / f"plain{suffix}"
        ).read_bytes()
