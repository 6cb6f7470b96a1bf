"""``[output] stages``: intermediate results of the sequential-angle classifier, in every output
format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.core.classes import Label, Surface
from prc_cli.core.stream import LabelledBlock, StageLabels
from prc_cli.formats.writing.columns import OutputConfig
from tests.formats.common import URBAN, labelled, random_labels, write
from tests.formats.las.lasbytes import make_las, parse

SOURCE = Path("drive.bin")
LINES = 15
M = 20
N = LINES * M
STAGES = OutputConfig(stages=True)
NAMES = ["surface", "dense_vegetation", "ground_height", "trigger", "car_interval", "car_test"]
NOTICE = "output.stages needs the fused, prc or sequential-angle method; nothing was added"


@dataclass
class Drive:
    """A classified stream; the record of a cell is ``order`` at its place."""

    blocks: list[LabelledBlock]
    present: np.ndarray
    surface: np.ndarray
    dense: np.ndarray
    height: np.ndarray
    trigger: np.ndarray
    interval: np.ndarray
    test: np.ndarray

    def columns(self) -> list[np.ndarray]:
        return [self.surface, self.dense, self.height, self.trigger, self.interval, self.test]


def drive(
    *,
    seed: int = 3,
    order: np.ndarray | None = None,
    missing: bool = False,
    without: tuple[int, ...] = (),
) -> Drive:
    """Blocks of four lines; the blocks numbered in ``without`` have no stages."""
    rng = np.random.default_rng(seed)
    labels = random_labels(N, URBAN, seed).reshape(LINES, M)
    if missing:
        labels[rng.random((LINES, M)) < 0.3] = Label.MISSING
    surface = rng.integers(0, 5, (LINES, M), dtype=np.uint8)
    dense = rng.random((LINES, M)) < 0.4
    height = np.repeat(rng.normal(-1.8, 0.1, (LINES, 1)), M, axis=1).astype(np.float32)
    height[5] = np.nan
    trigger = rng.integers(0, 4, (LINES, M), dtype=np.uint8)
    interval = rng.integers(0, 1 << 16, (LINES, M), dtype=np.uint16)
    test = rng.integers(0, 7, (LINES, M), dtype=np.uint8)
    car_surface = np.where(dense, Surface.VEGETATION, Surface.HORIZONTAL).astype(np.uint8)
    record = None if order is None else order.reshape(LINES, M)
    blocks = []
    for number, first in enumerate(range(0, LINES, 4)):
        rows = slice(first, first + 4)
        stages: StageLabels | None = StageLabels(
            surface[rows],
            car_surface[rows],
            height[rows],
            trigger[rows],
            interval[rows],
            test[rows],
        )
        if number in without:
            stages = None
            surface[rows] = 0
            dense[rows] = False
            height[rows] = np.nan
            trigger[rows] = 0
            interval[rows] = 0
            test[rows] = 0
        record_of_rows = None if record is None else record[rows]
        blocks.append(
            labelled(labels[rows], first_line=first, record=record_of_rows, stages=stages)
        )
    return Drive(blocks, labels != Label.MISSING, surface, dense, height, trigger, interval, test)


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
    block = drive(order=order)
    write(output, source, block.blocks, options=STAGES)
    old = laspy.read(source)
    new = laspy.read(output)
    assert list(new.point_format.extra_dimension_names) == [
        *old.point_format.extra_dimension_names,
        *NAMES,
    ]
    for name, expected in zip(NAMES, block.columns(), strict=True):
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
    blocks = drive(without=(0, 1, 2, 3)).blocks
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
