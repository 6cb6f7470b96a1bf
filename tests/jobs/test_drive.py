"""Several files of one drive are one stream."""

from itertools import pairwise
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.jobs.classify import classify
from prc_cli.jobs.drive import classify_drive
from tests.street import street, write_npz


@pytest.mark.parametrize("gap_s", [0.0, 7.0])
def test_classes_of_parts_are_those_of_the_joined_file_until_a_gap(tmp_path, gap_s):
    urban = load_config(preset="prc-2019-urban")
    classify(write_npz(tmp_path / "drive.npz", street()), tmp_path / "drive.laz", urban)
    las = laspy.read(tmp_path / "drive.laz")
    n = len(las)
    las.gps_time = 100 + np.arange(n) * 1e-5 + gap_s * (np.arange(n) >= n // 2)

    def cut(name: str, *ends: int) -> list[Path]:
        paths = [tmp_path / f"{name}_{k}.laz" for k in range(len(ends) - 1)]
        for path, part in zip(paths, pairwise(ends), strict=True):
            las[slice(*part)].write(path)
        return paths

    expected = []
    for path in cut("whole", 0, *([n // 2] if gap_s else []), n):
        classify(path, path.with_suffix(".npy"), urban)
        expected.append(np.load(path.with_suffix(".npy")))
    parts = cut("part", 0, n // 3 + 5, n // 2, n)
    outputs = [summary.output for summary in classify_drive(parts, tmp_path / "out", urban)]
    written = [laspy.read(path).classification for path in outputs]
    np.testing.assert_array_equal(np.concatenate(written), np.concatenate(expected))
