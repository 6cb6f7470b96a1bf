"""Scores of the contest: confusion, and F1 of classes that exist in the scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.contest_data import Scan
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.types import F64, I64
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.scores import scores

FOLDER = Path(__file__).resolve().parent
MAPPINGS = {
    "street": FOLDER / "contest_street.toml",
    "forest": FOLDER / "contest_forest.toml",
    "cylinders": "lehtola_forest",
    "oakland": FOLDER / "contest_oakland.toml",
    "kitti": FOLDER / "contest_kitti.toml",
    "views_kitti": FOLDER / "contest_views_kitti.toml",
    "views_nuscenes": FOLDER / "contest_views_nuscenes.toml",
}
"""File or name of the mapping, as for ``prc evaluate --mapping``."""
THINGS: dict[str, dict[str, list[int]]] = {
    "street": {"car": [65], "pole": [69]},
    "oakland": {"car": list(range(1500, 1600))},
    "kitti": {"car": [10, 13, 16, 18, 20, 252, 257, 258, 259], "pole": [80, 81]},
    "views_kitti": {"car": [1, 4, 5], "pole": [18, 19]},
    "views_nuscenes": {"car": [7, 8, 9], "pole": [3]},
}
"""Reference codes of cars, lorries and buses, and of poles, which are no class of the confusion.

Their predictions are reported beside it."""
UNKNOWN = {"oakland": [0, 1001, 1002, 1003], "views_nuscenes": [10]}
"""Reference codes of what is not known; elsewhere 0."""
CURB = "curb, 10 cm"
CURB_M = 0.1
"""Tolerance of curbs [m]."""
LEAST_SHARE = 0.005
"""Least share of judged returns for a class to exist in a scan.

Below it, the score depends on a few shots.
"""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of a method on one or several scans."""

    matrix: ConfusionMatrix
    others: dict[str, dict[str, int]] = field(default_factory=dict)
    """By name of reference codes that are not judged: number of returns per predicted class."""

    @property
    def present(self) -> tuple[str, ...]:
        """Classes of the reference that have enough returns to be judged."""
        sums = self.matrix.counts.sum(axis=1)
        least = max(LEAST_SHARE * sums.sum(), 1)
        names = zip(self.matrix.reference_names, sums.tolist(), strict=True)
        return tuple(name for name, n in names if n >= least)

    def f1(self) -> dict[str, float]:
        """Return the F1 of the classes that exist."""
        by_name = scores(self.matrix).by_name
        return {name: by_name[name].f1 for name in self.present}

    @property
    def macro(self) -> float:
        """Mean F1 of the classes that exist."""
        return float(np.mean(list(self.f1().values())))

    @property
    def worst(self) -> str:
        """The class with the lowest F1."""
        f1 = self.f1()
        return min(f1, key=lambda name: f1[name])

    def __add__(self, verdict: Verdict) -> Verdict:
        """Pool two verdicts of the same classes."""
        others = {
            name: {column: n + verdict.others[name][column] for column, n in became.items()}
            for name, became in self.others.items()
        }
        return Verdict(self.matrix + verdict.matrix, others)


@lru_cache(maxsize=8)
def mapping_of(name: str) -> ClassMapping:
    return load_mapping(MAPPINGS[name])


def compared(name: str, predicted: NDArray[np.integer], reference: I64) -> ConfusionMatrix:
    """Return the confusion of records by a mapping of :data:`MAPPINGS`.

    ``predicted``: what a method left out, 0, counts as unclassified.
    """
    mapping = mapping_of(name)
    codes = np.where(predicted == 0, 1, predicted).astype(np.int64)
    return accumulate(ConfusionMatrix.empty(mapping), codes, reference, mapping)


def judge(scan: Scan, codes: NDArray[np.integer], extra_codes: NDArray[np.integer]) -> Verdict:
    """Compare codes with the reference of a scan, all returns of it.

    Parameters
    ----------
    scan : Scan
    codes : (lines, M) integer
        Default codes of this program; ignored where there is no return.
    extra_codes : (e,) integer
        The same of the further returns.
    """
    there = ~np.isnan(scan.range_m)
    predicted = np.maximum(np.concatenate([codes[there], extra_codes]).astype(np.int64), 1)
    reference = np.concatenate([scan.codes[there], scan.extra_codes])
    matrix = compared(scan.mapping, predicted, reference)
    columns = matrix.predicted_names
    index = mapping_of(scan.mapping).class_indices(predicted, "predicted")
    others = {}
    for name, listed in THINGS.get(scan.mapping, {}).items():
        n = np.bincount(index[np.isin(reference, listed)], minlength=len(columns))
        others[name] = dict(zip(columns, n.tolist(), strict=True))
    return Verdict(matrix, others)


def judge_things(scan: Scan, codes: NDArray[np.integer]) -> dict[str, list[float]]:
    """Count cars, poles and curbs, first returns alone.

    Parameters
    ----------
    scan : Scan
    codes : (lines, M) integer
        Default codes of this program; ignored where there is no return.

    Returns
    -------
    dict
        By class: shots that agree, that are predicted, and of the reference. A curb agrees if one
        of the other side is within 10 cm; in the first count those of the reference, in the second
        scaled so that the share is the precision.
    """
    there = ~np.isnan(scan.range_m) & ~np.isin(scan.codes, UNKNOWN.get(scan.mapping, [0]))
    predicted = codes[there]
    reference = scan.codes[there]
    class_codes = ClassCodes()
    verdicts = {}
    for name, listed in THINGS.get(scan.mapping, {}).items():
        said = predicted == class_codes.code(Label[name.upper()])
        true = np.isin(reference, listed)
        verdicts[name] = [float((said & true).sum()), float(said.sum()), float(true.sum())]
    if scan.world_m is not None and scan.mapping == "street":
        place = scan.world_m[there]
        curb = class_codes.code(Label.CURB)
        verdicts[CURB] = curbs(place[predicted == curb], place[reference == curb])
    return verdicts


def curbs(ours: F64, theirs: F64) -> list[float]:
    """Return the three counts of curbs by their places, (n, 3) and (m, 3) [m]."""
    agree = _near(theirs, ours)
    right = _near(ours, theirs)
    return [float(agree), len(ours) * agree / max(right, 1), float(len(theirs))]


def _near(points: F64, others: F64) -> int:
    """Count the points with another within the tolerance."""
    if not len(points) or not len(others):
        return 0
    away, _ = cKDTree(others).query(points, distance_upper_bound=CURB_M)
    return int((away < np.inf).sum())
