"""PRC on the simulated street shows the effects described in the paper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes
from prc_cli.core.types import F32, U8
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.jobs.classify import classify_ranges
from prc_cli.simulation.settings import load_settings, open_simulation

LINES = 3 * 99


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Ranges of a residential street, and what was hit."""

    range_m: F32
    labels: U8

    def shares(self, zeta_p: float) -> dict[tuple[str, str], float]:
        """Share of every reference class that PRC calls so, as Table I has it."""
        config = load_config(preset="urban", options={"prc": {"support": {"zeta_p": zeta_p}}})
        found = classify_ranges(self.range_m, config).labels
        mapping, lookup = load_mapping("lehtola_urban"), ClassCodes().lookup()
        matrix = accumulate(ConfusionMatrix.empty(mapping), lookup[found], lookup[self.labels], mapping)
        rows = zip(matrix.reference_names, matrix.row_shares(), strict=True)
        return {(row, column): float(share) for row, shares in rows
                for column, share in zip(matrix.predicted_names, shares, strict=True)}  # fmt: skip


def drive(setback_m: float) -> Drive:
    scene = {"name": "residential", "setback_m": setback_m}
    settings = load_settings("street", options={"lines": LINES, "seed": 2, "scene": scene})
    items = list(open_simulation("street", settings).scan.labelled_blocks())
    return Drive(
        np.concatenate([item.block.range_m for item in items]), np.concatenate([item.labels for item in items])
    )


@pytest.fixture(scope="module")
def street() -> Drive:
    return drive(setback_m=0.0)


@pytest.fixture(scope="module")
def published(street: Drive) -> dict[tuple[str, str], float]:
    return street.shares(zeta_p=1.0)


@pytest.mark.parametrize(("name", "at_least"), [("ground", 0.95), ("noise", 0.6), ("vegetation", 0.6)])
def test_published_parameters_find_ground_noise_and_vegetation(
    published: dict[tuple[str, str], float], name: str, at_least: float
) -> None:
    assert published[name, name] > at_least


def test_noise_that_is_not_found_lies_near_the_ground(published: dict[tuple[str, str], float]) -> None:
    missed = {column: published["noise", column] for column in ("ground", "vegetation", "building")}
    assert max(missed, key=lambda column: missed[column]) == "ground"


def test_a_smaller_threshold_trades_as_in_table_i(street: Drive, published: dict[tuple[str, str], float]) -> None:
    tight = street.shares(zeta_p=0.1)
    for name in ("ground", "vegetation"):
        assert tight[name, name] < published[name, name]
    for name in ("noise", "building"):
        assert tight[name, name] > published[name, name]
    assert tight["building", "ground"] < published["building", "ground"]


def test_facades_farther_from_the_road_leak_less_into_the_ground(published: dict[tuple[str, str], float]) -> None:
    far = drive(setback_m=15.0).shares(zeta_p=1.0)
    assert far["building", "ground"] < published["building", "ground"] - 0.1
    assert far["building", "building"] > published["building", "building"] + 0.1
