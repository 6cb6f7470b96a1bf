"""Every label of the real scans is in the preset for them."""

from __future__ import annotations

import csv
import gzip
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from prc_cli.evaluation.mapping import load_mapping

pytestmark = pytest.mark.data


@pytest.mark.parametrize("name", ["oakland_1", "oakland_2", "oakland_3"])
def test_oakland_labels_are_all_listed(real_data: Path, name: str) -> None:
    with gzip.open(real_data / "oakland" / f"{name}.csv.gz", "rt", encoding="utf-8") as handle:
        counts = Counter(row["label"] for row in csv.DictReader(handle))
    codes = np.array([int(label or 0) for label in counts])
    mapping = load_mapping("oakland")
    indices = mapping.class_indices(codes, "reference")
    shots = np.bincount(indices + 1, weights=np.array(list(counts.values())), minlength=5)
    by_name = dict(zip(("ignored", *mapping.names("reference")), shots, strict=True))
    assert by_name["ground"] > 0.4 * shots.sum()
    assert by_name["ignored"] > 0.1 * shots.sum()  # no return, or undetermined
    assert by_name["vegetation"] > 0
    assert 0 < by_name["other"] < 0.1 * shots.sum()


def test_semantic_kitti_labels_are_all_listed(real_data: Path) -> None:
    labels = np.fromfile(real_data / "kitti" / "000000.label", dtype="<u4") & 0xFFFF
    mapping = load_mapping("semantic_kitti")
    found = np.bincount(mapping.class_indices(labels, "reference") + 1, minlength=6)
    assert found[0] == np.count_nonzero(labels == 0)
    assert found[1 + mapping.names("reference").index("ground")] > 0.5 * found.sum()


@pytest.mark.parametrize("strip", [1, 2, 3])
def test_oakland_labels_have_a_street_scan_class(real_data: Path, strip: int) -> None:
    with gzip.open(real_data / "oakland" / f"oakland_{strip}.csv.gz", "rt", encoding="utf-8") as handle:
        codes = np.array([int(row["label"] or 0) for row in csv.DictReader(handle)])
    mapping = load_mapping("street_scan_oakland")
    indices = mapping.class_indices(codes, "reference")
    # no vehicle stands in the third strip
    wanted = {"vegetation", "vertical", "horizontal"} | ({"car"} if strip < 3 else set())
    assert wanted == {mapping.names("reference")[i] for i in set(indices[indices >= 0].tolist())} - {"other"}


def test_semantic_kitti_labels_have_a_street_scan_class(real_data: Path) -> None:
    labels = np.fromfile(real_data / "kitti" / "000000.label", dtype="<u4") & 0xFFFF
    mapping = load_mapping("street_scan_kitti")
    indices = mapping.class_indices(labels, "reference")
    assert np.array_equal(indices < 0, labels == 0)
    assert np.count_nonzero(indices == mapping.names("reference").index("car")) == 4234
