"""Outputs against a tree of references, where comparing a file ends the process."""

import numpy as np
import pytest

from prc_cli.jobs.batch.references import Output, evaluate_tree
from prc_cli.jobs.batch.types import ReferenceSettings
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
