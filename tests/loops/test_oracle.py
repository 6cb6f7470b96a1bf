"""The loops of both papers against their slow twins, bit for bit, on data with many ties.

Twins share no code with loops. Loops of our own methods have none: see ``test_digests``.
"""

import ast
import inspect
import sys
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import Generator

from prc_cli.core.loops import use_engine
from prc_cli.core.threads import read_ahead
from prc_cli.core.types import F32, I32, Mask
from prc_cli.methods.prc.components_loops import label_components
from prc_cli.methods.prc.support_loops import support_mask
from prc_cli.methods.prc.surfaces_loops import dilate
from prc_cli.reference.prc import stages as oracle
from tests import patience
from tests.loops import recorded
from tests.loops.twins import LOOPS, assert_equal_bits, has_twin, twin, twin_module
from tests.methods.prc import paper

SHAPES = [(1, 1), (1, 2), (2, 1), (7, 1), (1, 9), (3, 2), (4, 3), (5, 5), (2, 17), (9, 40)]


def window(rng: Generator, n_lines: int, n_columns: int) -> F32:
    """Ranges on the millimetre or 1/16 grid around a few levels, with missing shots and absent
    ends."""
    reach = max(n_columns + 1, 4)
    size = n_lines * n_columns + 2 * reach
    if rng.random() < 0.5:
        ranges = rng.choice([5.0, 5.5, 6.0, 7.0], size) + rng.integers(-8, 9, size) / 16
    else:
        ranges = rng.choice([5.0, 5.1, 6.0, 6.1], size) + rng.integers(-3, 4, size) * 0.001
    ranges[rng.random(size) < rng.choice([0.0, 0.05, 0.5])] = np.nan
    ranges[: rng.integers(0, reach + 1)] = np.nan
    ranges[size - rng.integers(0, reach + 1) :] = np.nan
    return ranges.astype(np.float32)


def shape(rng: Generator) -> tuple[int, int]:
    return SHAPES[rng.integers(len(SHAPES))]


def blobs(rng: Generator) -> Mask:
    image: Mask = rng.random(shape(rng)) < rng.choice([0.0, 0.3, 0.6, 0.8, 1.0])
    return image


def support_case(rng: Generator) -> tuple[Any, ...]:
    n_lines, n_columns = shape(rng)
    zetas = [0.0, 1e-45, 1e-9, 0.001, 0.1, float(np.float32(0.1)), 0.0625, 0.5, 1.0, 1e9]
    zeta_p, zeta_s = (zetas[i] for i in rng.integers(len(zetas), size=2))
    counts = (int(rng.integers(0, 9)), int(rng.integers(0, 7)))
    return (window(rng, n_lines, n_columns), n_lines, n_columns, zeta_p, zeta_s, *counts)


def background_case(rng: Generator) -> tuple[Any, ...]:
    n_lines, n_columns = shape(rng)
    ranges = window(rng, n_lines, n_columns)
    reach = max(n_columns + 1, 4)
    valid = ~np.isnan(ranges[reach:-reach]).reshape(n_lines, n_columns)
    supported = valid & (rng.random((n_lines, n_columns)) < 0.8)
    alpha = float(rng.choice([0.25, 0.3, 0.125]))
    return (
        ranges,
        supported,
        int(rng.integers(4)),
        alpha,
        float(rng.choice([0.05, 0.0625, 0.001, 1.0])),
    )


def label_case(rng: Generator) -> tuple[Any, ...]:
    return (blobs(rng),)


def fill_case(rng: Generator) -> tuple[Any, ...]:
    """Images with many small components and holes in rows, so that ties and holes without
    neighbours occur."""
    supported = blobs(rng)
    return supported, supported & (rng.random(supported.shape) < rng.choice([0.1, 0.3, 0.6, 1.0]))


def carry_case(rng: Generator) -> tuple[Any, ...]:
    """Stretches of few numbers: equal counts, pairs that come again, labels in any order."""
    n_components = int(rng.integers(1, 5))
    stretch = int(rng.integers(1, 4))
    n = int(rng.integers(1, 12))
    first: I32 = rng.integers(0, n_components + 1, n).astype(np.int32).repeat(stretch)
    last = rng.choice([0, 7, 3, 1 << 40, 5], n * stretch)
    if rng.random() < 0.5:
        last = last[:n].repeat(stretch)
    return first, last.astype(np.int64), n_components, int(rng.integers(1, 5))


def image_case(rng: Generator) -> tuple[Mask, Mask, I32, int]:
    """S, an image over it, and components that may lie anywhere."""
    supported = blobs(rng)
    covered = rng.random(supported.shape) < rng.choice([0.0, 0.02, 0.5, 1.0])
    n_components = int(rng.integers(0, 6))
    return (
        supported,
        covered,
        rng.integers(0, n_components + 1, supported.shape).astype(np.int32),
        n_components,
    )


def select_case(rng: Generator) -> tuple[Any, ...]:
    supported, _, components, n_components = image_case(rng)
    return supported, components, rng.random(n_components + 1) < 0.5


def draw_case(rng: Generator) -> tuple[Any, ...]:
    supported, covered, components, n_components = image_case(rng)
    ranges = window(rng, *supported.shape)
    label_of = rng.integers(0, 250, n_components + 1).astype(np.uint8)
    return ranges, supported, covered, components, label_of, np.array([0, 251, 250], np.uint8)


def columns_case(rng: Generator) -> tuple[Any, ...]:
    supported, covered, _, _ = image_case(rng)
    columns = rng.random(supported.shape[1]) < 0.5
    labels_of = np.array([0, 2, 3, 5, 6], dtype=np.uint8)
    return (
        window(rng, *supported.shape),
        supported,
        covered,
        columns,
        bool(rng.random() < 0.5),
        labels_of,
    )


def dilate_case(rng: Generator) -> tuple[Any, ...]:
    return rng.random(shape(rng)) < rng.choice([0.0, 0.02, 0.2]), int(rng.choice([0, 1, 2, 3, 50]))


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "background_mask": background_case,
    "dilate": dilate_case,
    "carry_labels": carry_case,
    "count_covered": image_case,
    "draw_columns": columns_case,
    "draw_components": draw_case,
    "join_and_fill": fill_case,
    "select_components": select_case,
    "label_components": label_case,
    "support_mask": support_case,
}
"""Random arguments for the loops of PRC, whose images have more ties than scans have."""
LEAST = 60
"""Random cases of every loop, more until both sides were seen; the long test takes all."""
MOST = 400
OF_PAPERS = sorted(name for name in LOOPS if has_twin(name))
RECORDED = sorted({*OF_PAPERS} - {*CASES})
EVERY = {"hmm_cusum": 4}
"""Which of the recorded cases, where the twin takes as long as all others together."""
TOLERANCES = {"line_angles": 2e-5, "signed_angles": 2e-5}
"""Steps of float32 at 180 deg; all other loops are equal bit for bit."""


@pytest.mark.parametrize("name", sorted(CASES))
@pytest.mark.parametrize(
    "seed, n_cases", [(20190, LEAST), pytest.param(9, MOST, marks=pytest.mark.long)]
)
def test_loop_equals_its_twin(name, seed, n_cases):
    compare_random(name, seed, n_cases)


@pytest.mark.parametrize("name", RECORDED)
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 8))]
)
def test_loop_equals_its_twin_in_scans(name, seed):
    compare_recorded(name, seed)


def compare_recorded(name: str, seed: int) -> None:
    cases = recorded.cases(name, seed)[:: EVERY.get(name, 1)]
    outputs = {repr(compare(name, case)) for case in cases}
    assert len(outputs) > 2, "the scans show one side"


def compare_random(name: str, seed: int, n_cases: int) -> None:
    rng = np.random.default_rng(seed)
    results = set()
    for number in range(MOST):
        if number >= n_cases and len(results) == 2:
            break
        output = compare(name, CASES[name](rng))
        values = np.asarray(output[0] if isinstance(output, tuple) else output)
        results.add(bool(values.any()))
    assert results == {False, True}, "the data shows only one side"


def compare(name: str, case: tuple[Any, ...]) -> Any:
    """Return what a loop gives, after its twin gave the same."""
    output = LOOPS[name](*recorded.copied(case))
    assert_equal_bits(output, twin(name)(*recorded.copied(case)), TOLERANCES.get(name, 0.0))
    return output


@given(zeta=st.floats(0, 1e9), steps=st.integers(-2, 2))
def test_support_limit_is_exact_at_the_float32_beside_zeta(zeta, steps):
    """A difference is below zeta as real numbers, however zeta falls between two float32 values."""
    difference = np.float32(zeta)
    for _ in range(abs(steps)):
        difference = np.nextafter(difference, np.float32(np.inf if steps > 0 else 0))
    # zero on both sides: the difference to it is exact
    case = np.zeros(9 + 2 * 10, dtype=np.float32)
    case[10 + 4] = difference
    supported = support_mask(case, 1, 9, zeta, 0.0, 8, 0)
    assert bool(supported[0, 4]) == (float(difference) < zeta)


def test_every_loop_of_a_paper_has_a_twin_of_the_same_arguments():
    assert set(OF_PAPERS) >= set(CASES)
    for name in OF_PAPERS:
        assert [*inspect.signature(LOOPS[name].py_func).parameters] == [
            *inspect.signature(twin(name)).parameters
        ], name


@pytest.mark.parametrize("shape", [(40, 41), (41, 40)])
def test_components_of_a_comb_and_a_chessboard(shape):
    comb = np.zeros(shape, dtype=bool)
    comb[:, ::2] = True
    comb[-1] = True
    chessboard = np.indices(shape).sum(axis=0) % 2 == 0
    for image, n_expected in ((comb, 1), (chessboard, chessboard.sum())):
        labels, n_components = label_components(image)
        assert n_components == n_expected
        assert_equal_bits((labels, n_components), oracle.label_components(image))


REFERENCE = """
import sys
import numpy as np
from prc_cli.config import load_config
from prc_cli.jobs.classify import classify_ranges

ranges = 20 + np.random.default_rng(1).normal(0, 0.005, (24, 90))
ranges[5:9, 30:60] = 7.0
for preset in ("prc-2019-urban", "prc-2019-forest", "street-scan"):
    config = load_config(preset=preset, options={"prc": {"lines_per_block": 7}}).config
    beams = np.linspace(0.5, 2.2, 90)
    print(classify_ranges(ranges, config, beam_rad=beams, threads=2,
    engine=sys.argv[1]).labels.tobytes().hex())
print("numba" in sys.modules, file=sys.stderr)
"""


@pytest.mark.slow
def test_the_reference_runs_through_the_same_composition_without_the_compiler():
    reference, compiled = (
        patience.run(
            [sys.executable, "-c", REFERENCE, how], capture_output=True, text=True, check=True
        )
        for how in ("reference", "compiled")
    )
    assert reference.stdout == compiled.stdout
    assert (reference.stderr.strip(), compiled.stderr.strip()) == ("False", "True")


def test_an_engine_holds_in_its_context_and_in_its_thread(
    monkeypatch,
):
    image = np.zeros((2, 2), np.bool_)
    monkeypatch.setattr(dilate, "reference", lambda: lambda image, gamma: "plain")
    with use_engine("reference"):
        beside: list[object] = []
        thread = threading.Thread(target=lambda: beside.append(dilate(image, 1)))
        thread.start()
        thread.join()
        assert dilate(image, 1) == "plain"
        with use_engine("compiled"):
            assert not dilate(image, 1).any()
        assert list(read_ahead(dilate(image, 1) for _ in range(1))) == ["plain"]
    assert isinstance(beside[0], np.ndarray)
    assert not dilate(image, 1).any()


def test_twins_share_no_code_with_loops():
    """Import-linter sees to what modules of the reference import."""
    for name in OF_PAPERS:
        assert twin_module(name).__name__.startswith("prc_cli.reference.")
    tree = ast.parse(inspect.getsource(paper))
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name for name in modules if name.startswith("prc_cli")} == {
        "prc_cli.core.classes",
        "prc_cli.core.types",
        "prc_cli.reference.prc.stages",
    }
