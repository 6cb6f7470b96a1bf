"""The runner with a method defined here, and the table of methods."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from prc_cli.config import RunConfig
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.kernels import KERNELS
from prc_cli.kernels.loading import short_name
from prc_cli.methods.base import Classifier, MethodParams, Needs, OneByOne, Part, Turn, Wanted
from prc_cli.methods.methods import METHODS, MethodTables, table_of
from prc_cli.methods.run import run_blocks


@dataclass(frozen=True, slots=True)
class Seen:
    """What the blocks before left."""

    n_lines: int
    total_m: float


N_LINES, TOTAL_M = Part[int]("n_lines"), Part[float]("total_m")


@dataclass(frozen=True, slots=True)
class Parity(Classifier[int, Seen]):
    """Labels lines by their number and by all ranges so far: odd or even."""

    k: int

    @property
    def needs(self) -> Needs:
        """Blocks of k lines."""
        return Needs(frozenset(), self.k, look_ahead=1, beams=False)

    def scanner(self, first: ScanBlock) -> int:
        """Return M."""
        return first.points_per_line

    def initial_state(self, scanner: int) -> Seen:
        """Return the state before the first line."""
        return Seen(0, 0.0)

    def label(self, block: ScanBlock, scanner: int, turn: Turn, wanted: Wanted) -> Sequence[LabelledBlock]:
        """Label a block."""
        first = turn.hand_on(N_LINES, lambda n: (n, n + block.n_lines))
        sums = block.range_m.sum(axis=1, dtype=np.float64)
        before = turn.hand_on(TOTAL_M, lambda total: (total, total + float(sums.sum())))
        odd = (np.arange(first, first + block.n_lines) + (before + np.cumsum(sums)).astype(int)) % 2
        labels = np.repeat(odd.astype(np.uint8)[:, None], scanner, axis=1)
        return (LabelledBlock(block, labels, np.empty(0, np.uint8)),)


def blocks(n_scanners: int = 2) -> Iterator[ScanBlock]:
    """Lines of several scanners in turns."""
    rng = np.random.default_rng(4)
    for first in range(0, 60, 5):
        for scanner in range(n_scanners):
            lines = rng.integers(1, 50, (5, 3 + scanner)).astype(np.float32)
            yield ScanBlock(first, lines, scanner=scanner)


def labels_of(method: Parity, threads: int) -> dict[int, list[list[int]]]:
    """Labels of every scanner."""
    found: dict[int, list[list[int]]] = {}
    for item in run_blocks(blocks(), method, threads=threads):
        found.setdefault(item.block.scanner, []).extend(item.labels.tolist())
    return found


@pytest.mark.parametrize("k", [1, 4, 7, 100])
def test_every_scanner_has_a_state_of_its_own_whatever_the_threads(k: int) -> None:
    alone = labels_of(Parity(1), 1)
    assert [len(lines) for lines in alone.values()] == [60, 60]
    for threads in (1, 2, 5):
        assert labels_of(Parity(k), threads) == alone


def test_blocks_one_by_one_give_the_same() -> None:
    method = Parity(5)
    turn, found = OneByOne(method.initial_state(3)), []
    for block in blocks(1):
        (item,) = method.label(block, 3, turn, Wanted())
        found += item.labels.tolist()
    lines = [line for item in run_blocks(blocks(1), method, threads=3) for line in item.labels.tolist()]
    assert found == lines
    assert turn.state.n_lines == 60


def test_a_runner_that_is_left_early_leaves_no_thread() -> None:
    found = run_blocks(blocks(), Parity(2), threads=3)
    next(found)
    found.close()  # type: ignore[attr-defined]


def test_the_table_holds_what_it_names() -> None:
    assert [table_of(method) for method in METHODS] == list(MethodTables.model_fields)
    homes = {short_name(home) for home in KERNELS.values()}
    for method in METHODS:
        params = RunConfig(method=method).classifier
        assert isinstance(params, MethodParams)
        for kernels in params.method().needs.kernels:
            assert any(home == kernels or home.startswith(f"{kernels}.") for home in homes)
