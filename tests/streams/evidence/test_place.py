"""Street or forest, from the first lines."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32
from prc_cli.streams.evidence.place import SAMPLE_LINES, place_of, place_of_blocks
from tests.methods.fused.street_lines import BEAM, street_lines


def forest_lines(n_lines: int, *, stems: bool = True) -> F32:
    """Patches of plants of 0.2 m, leaves on both sides, and a few stems."""
    rng = np.random.default_rng(4)
    side, down = np.sin(BEAM), np.cos(BEAM)
    with np.errstate(divide="ignore"):
        plants = rng.uniform(0, 0.2, (n_lines, len(BEAM))) * (np.arange(len(BEAM)) // 30 % 2)
        floor = np.where(down > 0, (1.8 - plants) / down, np.inf)
        leaves = np.where(down < 0.4, rng.uniform(3, 12, floor.shape) / np.abs(side), np.inf)
        stem = np.where((side > 0) & (np.arange(n_lines) % 8 == 0)[:, None], 5 / side, np.inf)
    every = np.minimum(floor, leaves)
    every = np.minimum(every, stem) if stems else every
    every[every > 60] = np.nan
    return every.astype(np.float32)


def test_streets_and_forests_are_told() -> None:
    street = place_of(street_lines(SAMPLE_LINES)[0], BEAM)
    forest = place_of(forest_lines(SAMPLE_LINES), BEAM)
    assert (street.kind, forest.kind) == ("street", "forest")
    assert "% of the ground is smooth" in forest.why


def test_a_lawn_between_trees_is_not_guessed() -> None:
    park = forest_lines(SAMPLE_LINES, stems=False)
    down = np.cos(BEAM) > 0.25
    park[:, down] = (1.8 / np.cos(BEAM[down])).astype(np.float32)
    assert place_of(park, BEAM).kind == "unknown"


@pytest.mark.parametrize("value", [np.nan, 3.0])
def test_too_little_is_not_guessed(value: float) -> None:
    for shape in ((1, len(BEAM)), (4, 2)):
        assert place_of(np.full(shape, value, np.float32), BEAM[: shape[1]]).kind == "unknown"
    assert place_of_blocks(iter(())).kind == "unknown"


def test_a_road_in_the_open_is_a_street() -> None:
    road = street_lines(SAMPLE_LINES)[0]
    road[:, np.cos(BEAM) < 0.2] = np.nan
    found = place_of(road, BEAM)
    assert found.kind == "street"
    assert "nothing stands high" in found.why


@pytest.mark.parametrize("cut", [1, 7, 64, 90])
def test_the_answer_depends_on_the_lines_alone(cut: int) -> None:
    lines = np.concatenate([np.full((5, len(BEAM)), np.nan, np.float32), street_lines(90)[0]])
    other = forest_lines(40)

    def blocks() -> list[ScanBlock]:
        found = []
        for start in range(0, len(lines), cut):
            found.append(ScanBlock(start, lines[start : start + cut], beam_rad=BEAM))
            found.append(ScanBlock(start, other, scanner=1, beam_rad=BEAM))
        return found

    assert place_of_blocks(iter(blocks())) == place_of(lines[5 : 5 + SAMPLE_LINES], BEAM)
