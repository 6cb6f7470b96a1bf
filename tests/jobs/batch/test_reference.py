"""Outputs against a tree of references.

The same as prc evaluate per file, pooled; files without reference are
listed."""

import json
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.formats.writing.record import record_path
from prc_cli.jobs.batch.references import Output, check_reference, evaluate_tree
from prc_cli.jobs.batch.types import ReferenceSettings
from prc_cli.jobs.evaluate import evaluate_all
from tests.fuzz.crafted import overflowing

PREDICTED = {"a.npz": [2, 2, 6, 0], "night/b.csv.gz": [2, 6, 6, 6, 5], "night/c.bin": [7, 7]}
REFERENCE = {"a.npz": [2, 6, 6, 0], "night/b.csv.gz": [2, 2, 6, 6, 5], "night/c.bin": [7, 2]}


def trees(folder: Path) -> tuple[list[Output], Path]:
    """Outputs as batch names them, and references under several of the names that are
    understood."""
    reference_names = {
        "a.npz": "a.npy",
        "night/b.csv.gz": "night/b.csv",
        "night/c.bin": "night/c.bin.labels.npy",
    }
    outputs = []
    for name, codes in PREDICTED.items():
        relative = f"{name}.labels.npy"
        path = folder / "out" / relative
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, np.array(codes, np.uint8))
        outputs.append(Output(name, relative, path, folder / "archive" / name))
        beside = folder / "ref" / reference_names[name]
        beside.parent.mkdir(parents=True, exist_ok=True)
        if beside.suffix == ".npy":
            np.save(beside, np.array(REFERENCE[name], np.uint8))
        else:
            beside.write_text("class\n" + "".join(f"{code}\n" for code in REFERENCE[name]))
    return outputs, folder / "ref"


@pytest.mark.slow
def test_every_file_and_all_together_as_prc_evaluate_has_them(tmp_path):
    outputs, tree = trees(tmp_path)
    evaluation = evaluate_tree(outputs, ReferenceSettings(tree), jobs=2)
    assert [item.name for item in evaluation.files] == list(PREDICTED)
    references = [tree / str(item.reference) for item in evaluation.files]
    whole = evaluate_all([output.path for output in outputs], references)
    np.testing.assert_array_equal(evaluation.matrix.counts, whole.matrix.counts)
    assert evaluation.matrix.n_ignored == whole.matrix.n_ignored == 1
    for output, reference, item in zip(outputs, references, evaluation.files, strict=True):
        assert item.matrix is not None
        np.testing.assert_array_equal(
            item.matrix.counts, evaluate_all([output.path], [reference]).matrix.counts
        )


@pytest.mark.slow
def test_the_mapping_is_that_of_the_method_in_the_run_records(tmp_path):
    outputs, tree = trees(tmp_path)
    gates = ("recall.ground=0.5", "recall.car=0")
    check_reference(ReferenceSettings(tree, gates=gates))
    # without run records: the classes of PRC, which has no cars
    evaluation = evaluate_tree(outputs, ReferenceSettings(tree, gates=gates))
    assert evaluation.as_dict()["mapping"] == "prc"
    assert [gate.passed for gate in evaluation.gates] == [True, False]
    record = {
        "program": "prc-cli",
        "config": {"method": "fused", "fused": {"environment": "urban"}},
    }
    for output in outputs:
        record_path(output.path).write_text(json.dumps(record))
    assert (
        evaluate_tree(outputs, ReferenceSettings(tree, gates=gates)).as_dict()["mapping"]
        == "street"
    )
    assert evaluate_tree(outputs, ReferenceSettings(tree, "prc")).as_dict()["mapping"] == "prc"
    with pytest.raises(ConfigError):
        check_reference(ReferenceSettings(tree, gates=("recall.dragon=0.5",)))


@pytest.mark.slow
def test_a_damaged_reference_costs_its_file_only(tmp_path):
    outputs, tree = trees(tmp_path)
    (tree / "a.npy").write_bytes(b"\x93NUMPY garbage")
    np.save(tree / "night" / "c.bin.labels.npy", np.array([7, 7, 7], np.uint8))
    evaluation = evaluate_tree(outputs, ReferenceSettings(tree))
    assert [item.name for item in evaluation.unpaired] == ["a.npz", "night/c.bin"]
    assert [item.problem.kind for item in evaluation.unpaired if item.problem] == [
        "InputError",
        "InputError",
    ]
    assert evaluation.matrix.n_scored == 5
    table = evaluation.as_dict()
    assert table["files"][0]["scores"] is None
    assert table["files"][1]["scores"]["n_scored"] == 5


@pytest.mark.parametrize(
    "changes, expected",
    [
        ({"mapping_name": "nothing"}, "nothing"),
        ({"match": "luck"}, "order, time"),
        ({"match": "dimension:"}, "order, time"),
        ({"gates": ("recall.nothing=0.5",)}, "nothing"),
        ({"gates": ("recall.ground",)}, "fail-under"),
    ],
)
def test_settings_that_make_no_sense_are_refused_before_any_work(tmp_path, changes, expected):
    with pytest.raises(ConfigError, match=expected):
        check_reference(ReferenceSettings(tmp_path, **changes))  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="no such folder"):
        check_reference(ReferenceSettings(tmp_path / "none"))


@pytest.mark.slow
def test_labels_alone_are_matched_through_the_points_of_the_input(tmp_path):
    times = np.arange(4) * 1e-3
    archive, out, tree = (tmp_path / name for name in ("archive", "out", "ref"))
    for folder in (archive, out, tree):
        folder.mkdir()
    rows = "".join(f"{t},{10 + k}\n" for k, t in enumerate(times))
    (archive / "a.csv").write_text("time,range\n" + rows)
    np.save(out / "a.csv.labels.npy", np.array([2, 6, 6, 5], np.uint8))
    backwards = "".join(f"{t},{code}\n" for t, code in zip(times[::-1], [5, 6, 2, 2], strict=True))
    (tree / "a.csv").write_text("time,class\n" + backwards)
    output = Output("a.csv", "a.csv.labels.npy", out / "a.csv.labels.npy", archive / "a.csv")
    evaluation = evaluate_tree([output], ReferenceSettings(tree, match="time"))
    assert evaluation.files[0].problem is None, evaluation.files[0].problem
    assert evaluation.matrix.n_scored == 4
    names = evaluation.matrix.reference_names, evaluation.matrix.predicted_names
    assert evaluation.matrix.counts[names[0].index("ground"), names[1].index("building")] == 1


@pytest.mark.slow
def test_a_file_that_ends_the_process_costs_its_own_comparison(tmp_path):
    """It ended the run, every night; the others are compared all the same."""
    outputs, tree = trees(tmp_path)
    crafted = overflowing()
    (tmp_path / "out" / "d.laz").write_bytes(crafted)
    (tree / "d.laz").write_bytes(crafted)
    outputs.insert(
        1, Output("d.laz", "d.laz", tmp_path / "out" / "d.laz", tmp_path / "archive" / "d.laz")
    )
    evaluation = evaluate_tree(outputs, ReferenceSettings(tree, match="time"))
    problem = evaluation.files[1].problem
    assert problem is not None
    assert problem.kind == "killed"
    assert problem.problem.startswith("its worker process was ended by signal")
    evaluation = evaluate_tree([*outputs[:1], *outputs[2:]], ReferenceSettings(tree))
    assert [item.matrix is not None for item in evaluation.files] == [True, True, True]
