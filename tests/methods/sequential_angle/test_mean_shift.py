"""Mean shift on the grid of the reference, which the loops equal bit for bit, against the textbook form."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F64
from prc_cli.reference.sequential_angle.ground import EIGHTHS, grid_modes


def modes_of(values: F64, bandwidth: float) -> list[tuple[float, int]]:
    """Place and samples of every mode."""
    width = bandwidth / EIGHTHS
    modes = grid_modes(np.floor(np.array(values) / width).astype(int).tolist())
    return [((place + 0.5) * width, count) for place, count in modes if count > 0]


def literal(values: F64, bandwidth: float) -> list[int]:
    """Shift a Gaussian window from every sample until it stands, merge where they end; samples of every mode."""
    ends = []
    for value in values:
        place = value
        while True:
            weight = np.exp(-0.5 * ((values - place) / bandwidth) ** 2)
            shifted = float(weight @ values / weight.sum())
            if abs(shifted - place) < 1e-3 * bandwidth:
                break
            place = shifted
        ends.append(shifted)
    ends.sort()
    return [len(group) for group in np.split(ends, np.flatnonzero(np.diff(ends) >= bandwidth / 2) + 1)]


def test_grid_decides_on_one_mode_as_literal_mean_shift_does() -> None:
    rng = np.random.default_rng(3)
    one_mode, groups, sizes = [], 0, 0
    for _ in range(600):
        apart = rng.choice([0.0, 0.0, 1.5, 2.5, 3.5, 6.0])
        second = rng.random(n := int(rng.integers(9, 50))) < rng.choice([0.1, 0.5])
        values = rng.normal(0, rng.choice([0.2, 0.5, 1.0]), n) + apart * second
        expected, found = literal(values, 1.0), [count for _, count in modes_of(values, 1.0)]
        one_mode.append((sum(c >= 2 for c in expected) == 1) == (sum(c >= 2 for c in found) == 1))
        groups += len(expected) == len(found)
        sizes += expected == found
    assert np.mean(one_mode) >= 0.98  # .993 of these
    assert groups / 600 >= 0.97
    assert sizes / 600 >= 0.85


def test_a_gaussian_has_one_mode_from_a_bandwidth_of_its_deviation_on() -> None:
    rng = np.random.default_rng(4)

    def share(b: float, n: int) -> float:
        return float(np.mean([len(modes_of(rng.normal(0, 1, n), b)) == 1 for _ in range(200)]))

    assert 0.3 < share(0.5, 9) < 0.7
    for n in (9, 50, 200):
        assert share(1.0, n) >= 0.98
        assert share(2.0, n) == 1.0


def test_order_of_samples_changes_nothing() -> None:
    rng = np.random.default_rng(5)
    values = rng.normal(0, 3, 200)
    found = modes_of(values, 0.7)
    assert found == modes_of(rng.permutation(values), 0.7)
    assert sum(count for _, count in found) == 200
