"""Outputs against a tree of references: each as alone, pooled as one, none costs another."""

import numpy as np
import pytest

from prc_cli.jobs.batch.references import Output, evaluate_tree
from prc_cli.jobs.batch.types import ReferenceSettings
from prc_cli.jobs.evaluate import evaluate_all
from tests.fuzz.crafted import overflowing


@pytest.mark.slow
def test_a_file_that_ends_the_process_costs_its_own_comparison(tmp_path):
    """It ended the run, every night; the others are compared all the same."""
    for folder in ("out", "ref"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "b.laz").write_bytes(overflowing())
        for name in ("a.npy", "c.npy"):
            np.save(tmp_path / folder / name, np.array([2, 6, 6, 0], np.uint8))
    outputs = [
        Output(name, name, tmp_path / "out" / name, tmp_path / "in" / name)
        for name in ("a.npy", "b.laz", "c.npy")
    ]
    files = evaluate_tree(outputs, ReferenceSettings(tmp_path / "ref")).files
    problem = files[1].problem
    assert problem is not None
    assert problem.kind == "killed"
    assert problem.problem.startswith("its worker process was ended by signal")
    assert [item.matrix is not None for item in files] == [True, False, True]


@pytest.mark.slow
def test_every_file_and_all_together_are_as_evaluate_counts_them(tmp_path):
    pairs = []
    outputs = []
    for k, (name, reference) in enumerate([("a.npz", "a.npy"), ("n/b.csv", "n/b.csv.labels.npy")]):
        relative = f"{name}.labels.npy"
        pairs.append((tmp_path / "out" / relative, tmp_path / "ref" / reference))
        for path, seed in zip(pairs[-1], (k, k + 5), strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, np.random.default_rng(seed).choice([0, 2, 5, 6, 7], 40 + k))
        outputs.append(Output(name, relative, pairs[-1][0], tmp_path / "in" / name))
    tree = evaluate_tree(outputs, ReferenceSettings(tmp_path / "ref"))
    sides = [tuple(zip(*pairs, strict=True)), *[tuple([side] for side in pair) for pair in pairs]]
    for matrix, (predicted, reference) in zip(
        [tree.matrix, *(item.matrix for item in tree.files)], sides, strict=True
    ):
        alone = evaluate_all(predicted, reference).matrix
        np.testing.assert_array_equal(matrix.counts, alone.counts)
        assert matrix.n_ignored == alone.n_ignored > 0
