"""The runner of all methods: scanners, further returns, reasons."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from operator import attrgetter

import numpy as np
import pytest

from prc_cli.config import RunConfig, load_config
from prc_cli.core.classes import Label, Reason
from prc_cli.core.errors import InputError
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.types import F32, U8
from prc_cli.methods.base import Classifier, MethodParams, Needs, Part, Turn, Wanted
from prc_cli.methods.forest.thresholds import FOREST
from prc_cli.methods.fused.thresholds import STREET
from prc_cli.methods.methods import METHODS, MethodTables, table_of
from prc_cli.methods.prc.pipeline import Prc, PrcParams
from prc_cli.methods.reasons import FURTHER, RULES, VOTE, reason_table
from prc_cli.methods.returns import label_extra_returns
from prc_cli.methods.rings.thresholds import MANY
from prc_cli.methods.run import run_blocks
from tests.methods.fused.street_lines import BEAM


@dataclass(frozen=True, slots=True)
class Seen:
    """What the blocks before left."""

    n_lines: int
    total_m: float


N_LINES = Part[int]("n_lines")
TOTAL_M = Part[float]("total_m")


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

    def label(
        self,
        block: ScanBlock,
        scanner: int,
        turn: Turn,
        wanted: Wanted,
    ) -> Sequence[LabelledBlock]:
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
    by_scanner: dict[int, list[list[int]]] = {}
    for item in run_blocks(blocks(), method, threads=threads):
        by_scanner.setdefault(item.block.scanner, []).extend(item.labels.tolist())
    return by_scanner


@pytest.mark.parametrize("k", [1, 4, 7, 100])
def test_every_scanner_has_a_state_of_its_own_whatever_the_threads(k):
    alone = labels_of(Parity(1), 1)
    assert [len(lines) for lines in alone.values()] == [60, 60]
    for threads in (1, 2, 5):
        assert labels_of(Parity(k), threads) == alone


def test_a_runner_that_is_left_early_leaves_no_thread():
    labelled = run_blocks(blocks(), Parity(2), threads=3)
    next(labelled)
    labelled.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "method, step",
    [
        ("prc", "background"),
        ("prc", "identify"),
        ("prc", "count_smooth"),
        ("prc", "urban"),
        ("fused", "_measure_noise"),
        ("fused", "measure_neighbours"),
        ("fused", "follow_ground"),
        ("fused", "_decide_stream"),
    ],
)
def test_a_block_that_fails_lets_the_others_end(monkeypatch, method, step):
    """Before, in, between and after the steps that hand on.

    Nobody waits for a turn that never comes.
    """
    pipeline = import_module(f"prc_cli.methods.{method}.pipeline")
    plain = getattr(pipeline, step)
    calls: list[None] = []

    def fails(*arguments: object, **named: object) -> object:
        calls.append(None)
        if len(calls) == 2:
            raise MemoryError(step)
        return plain(*arguments, **named)

    monkeypatch.setattr(pipeline, step, fails)
    block = ScanBlock(0, np.ones((24, len(BEAM)), np.float32), beam_rad=BEAM)
    params = load_config(options={"method": method, method: {"lines_per_block": 4}}).config
    with pytest.raises(MemoryError, match=step):
        list(run_blocks(iter([block]), params.classifier.method(), threads=2))


def test_lines_of_another_length_are_refused():
    blocks = [ScanBlock(0, np.ones((4, 5), np.float32)), ScanBlock(4, np.ones((5, 4), np.float32))]
    with pytest.raises(InputError, match=r"found an array of shape \(\d, 4\)"):
        list(run_blocks(iter(blocks), Prc(PrcParams(lines_per_block=2)), threads=2))


def test_the_table_holds_what_it_names():
    assert [table_of(method) for method in METHODS] == list(MethodTables.model_fields)
    for method in METHODS:
        params = RunConfig(method=method).classifier
        assert isinstance(params, MethodParams)
        assert params.method().needs.loops


def label_one(
    image: F32,
    labels: U8,
    cell: tuple[int, int],
    range_m: float,
    zeta_p: float,
    zeta_s: float,
) -> int:
    """What the rule says, one return and one cell at a time."""
    line, column = cell
    candidates = []
    for order, (y, x, zeta) in enumerate(
        [(line, column + dx, zeta_p) for dx in range(-4, 5)]
        + [(line + dy, column + dx, zeta_s) for dy in (-1, 1) for dx in (-1, 0, 1)]
    ):
        if 0 <= y < image.shape[0] and 0 <= x < image.shape[1] and not np.isnan(image[y, x]):
            difference = abs(float(np.float32(range_m) - image[y, x]))
            if difference < zeta:
                candidates.append((difference, order, int(labels[y, x])))
    return min(candidates)[2] if candidates else Label.NOISE


@pytest.mark.parametrize("zeta_p, zeta_s", [(1.0, 1.0), (0.25, 1.0), (1.0, 0.1), (0.0, 0.5)])
def test_rule_one_return_at_a_time(zeta_p, zeta_s):
    rng = np.random.default_rng(11)
    for n_lines, width in [(1, 1), (1, 12), (2, 3), (9, 15)]:
        image = (rng.integers(16, 40, (n_lines, width)) / 8).astype(np.float32)
        image[rng.random(image.shape) < 0.2] = np.nan
        labels = rng.integers(1, 7, image.shape).astype(np.uint8)
        line = rng.integers(n_lines, size=200)
        column = rng.integers(width, size=200)
        ranges = (rng.integers(16, 48, 200) / 8).astype(np.float32)
        labels_extra = label_extra_returns(
            image, labels, line.astype(np.int32), column.astype(np.int32), ranges, zeta_p, zeta_s
        )
        expected = [
            label_one(image, labels, (y, x), r, zeta_p, zeta_s)
            for y, x, r in zip(line, column, ranges, strict=True)
        ]
        assert labels_extra.dtype == np.uint8
        np.testing.assert_array_equal(labels_extra, expected)


def test_every_reason_has_a_sentence_and_limits_that_exist():
    assert set(RULES) == set(Reason)
    assert len({rule.sentence for rule in RULES.values()}) == len(RULES)
    config = RunConfig()
    constants = (STREET, FOREST, MANY)
    for rule in (*RULES.values(), VOTE, FURTHER):
        for name in rule.limits:
            if name.startswith(("prc.", "sequential_angle.")):
                attrgetter(name)(config)
            else:
                assert any(hasattr(limits, name.partition(".")[0]) for limits in constants), name
                [
                    attrgetter(name)(limits)
                    for limits in constants
                    if hasattr(limits, name.partition(".")[0])
                ]
    numbers = [number for number, *_ in reason_table()]
    assert numbers == [*sorted(RULES), 224, 240]
