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
from tests.formats.las.lasbytes import EXTRA, make_las, parse

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
    stages = {
        "surface": rng.integers(0, 5, shape, dtype=np.uint8),
        "dense_vegetation": rng.random(shape) < 0.4,
        "ground_height": rng.normal(-1.8, 0.1, shape).astype(np.float32),
        "trigger": rng.integers(0, 4, shape, dtype=np.uint8),
        "car_interval": rng.integers(0, 1 << 16, shape, dtype=np.uint16),
        "car_test": rng.integers(0, 7, shape, dtype=np.uint8),
    }
    stages["ground_height"][5] = np.nan
    surfaces = np.array([Surface.HORIZONTAL, Surface.VEGETATION], np.uint8)
    columns = {**stages, "dense_vegetation": surfaces[stages["dense_vegetation"].astype(int)]}
    blocks = []
    for first in range(0, LINES, 4):
        rows = slice(first, first + 4)
        kept = StageLabels(*(values[rows] for values in columns.values()))
        record = order.reshape(shape)[rows]
        block = labelled(
            labels[rows], first_line=first, record=record, stages=kept if has_stages else None
        )
        blocks.append(block)
    return blocks, stages


def same_bits(actual: np.ndarray, expected: np.ndarray) -> bool:
    return np.array_equal(
        np.asarray(actual, np.float32).view("u4"), np.asarray(expected, np.float32).view("u4")
    )


@pytest.mark.parametrize("extra", [(), EXTRA])
@pytest.mark.parametrize(
    ("form", "before", "after"), [(1, ".las", ".laz"), (3, ".laz", ".las"), (6, ".laz", ".laz")]
)
def test_rewritten_files_hold_them(
    tmp_path: Path,
    form: int,
    before: str,
    after: str,
    extra: tuple[laspy.ExtraBytesParams, ...],
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


@pytest.mark.parametrize("suffix", [".laz", ".csv", ".parquet", ".npy"])
def test_a_method_without_stages_adds_nothing(tmp_path: Path, suffix: str) -> None:
    """The output is that of a run without the option, but for a notice in the run's record."""
    blocks, _ = drive(np.arange(N), has_stages=False)
    asked = tmp_path / f"asked{suffix}"
    plain = tmp_path / f"plain{suffix}"
    record = write(asked, SOURCE, blocks, options=STAGES)
    write(plain, SOURCE, blocks)
    needs = "a .npy output holds class codes only; stages need .csv, .parquet, .las or .laz"
    notices = [text for text in record.notices if "stages" in text]
    assert notices == [needs if suffix == ".npy" else NOTICE]
    if suffix == ".laz":
        assert np.array_equal(parse(asked).records, parse(plain).records)
    else:
        assert asked.read_bytes() == plain.read_bytes()
