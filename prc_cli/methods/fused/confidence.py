"""How sure every label is, in per cent; runs only if confidence is wanted.

A shot has six measures, different ones for every label: how far it is from the limits that
decided, how many of the shots around have its label, whether it was seen from near and steeply.
Each measure has four steps. The confidence is the share of right labels among the shots with this
label and these steps on simulated streets or forests: a table that ``python -m
benchmarks.confidence calibrate`` makes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.profile import stage
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, I32, I64, U8
from prc_cli.methods.fused.confidence_loops import confidence_cells
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.records import Neighbours
from prc_cli.methods.fused.strips import Strips
from prc_cli.methods.returns import label_extra_returns

Environment = Literal["urban", "forest"]

MEASURES: dict[str, tuple[float, float, float]] = {
    "agree": (0.5, 0.8, 0.95),
    "smooth": (1, 4, 8),
    "texture": (0.2, 0.6, 0.9),
    "near": (1, 8, 20),
    "upright": (1, 2, 3),
    "level": (1, 2, 3),
    "off": (0.03, 0.06, 1.5),
    "steep": (0.0, 0.25, 0.5),
    "range": (5, 10, 20),
    "rough": (0.5, 0.8, 0.95),
    "top": (1.5, 2.25, 4),
    "filled": (1, 2, 4),
    "ahead": (0.0, 0.3, 49),
    "behind": (-49, -0.3, 0.3),
    "jump": (0.1, 0.5, 2),
}
"""Measures in the order of :func:`confidence_loops.confidence_cells`, and the steps of their four
answers."""
STREET_QUESTIONS: dict[Label, tuple[str, ...]] = {
    Label.NOISE: ("near", "range", "off", "top", "texture", "agree"),
    Label.GROUND: ("level", "off", "range", "smooth", "upright", "near"),
    Label.BUILDING: ("range", "ahead", "smooth", "steep", "top", "agree"),
    Label.VEGETATION: ("behind", "agree", "filled", "near", "smooth", "rough"),
    Label.CAR: ("range", "smooth", "agree", "ahead", "near", "steep"),
    Label.CURB: ("texture", "agree", "near", "steep", "level", "smooth"),
    Label.POLE: ("range", "steep", "rough", "jump", "level", "upright"),
}
FOREST_QUESTIONS: dict[Label, tuple[str, ...]] = {
    Label.NOISE: ("agree", "near", "top", "range", "steep", "texture"),
    Label.GROUND: ("smooth", "off", "range", "agree", "texture", "near"),
    Label.VEGETATION: ("texture", "off", "smooth", "agree", "range", "near"),
    Label.STEM: ("smooth", "agree", "off", "near", "level", "texture"),
}
QUESTIONS: dict[Environment, dict[Label, tuple[str, ...]]] = {
    "urban": STREET_QUESTIONS,
    "forest": FOREST_QUESTIONS,
}
"""Measures of the shots of every label. Labels without any have no confidence, 0."""
N_QUESTIONS = 6
N_CELLS = 4**N_QUESTIONS
"""Sets of answers."""
GROUPS = {
    Label.GROUND: 0,
    Label.CURB: 0,
    Label.BUILDING: 1,
    Label.STEM: 1,
    Label.VEGETATION: 2,
    Label.CAR: 3,
    Label.POLE: 4,
    Label.UNCLASSIFIED: 4,
    Label.NOISE: 5,
}
"""Labels that agree with each other."""
TABLE = Path(__file__).with_name("confidence.json")


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Measurements by which the labels of a block were decided."""

    neighbours: Neighbours
    above_m: F32
    """Above the ground in the scan plane [m]; of more lines, as ``neighbours``."""
    texture: F32
    """Of one line more before and after."""
    strips: Strips
    """Of one line more before and after."""
    margin: int
    """Lines of ``neighbours`` and ``above_m`` before and after the block."""


@stage("confidence")
def cells_of(
    labels: U8,
    range_m: F32,
    evidence: Evidence,
    plane: ScanPlane,
    questions: dict[Label, tuple[str, ...]],
) -> I32:
    """Return the answers of every shot as the number of a cell of the table.

    ``labels`` (lines, M) uint8; ``range_m`` (lines, M) float32, metres; returns (lines, M) int32.
    """
    lines = slice(evidence.margin, evidence.margin + len(labels))
    strip_lines = slice(1, 1 + len(labels))
    cells: I32 = confidence_cells(
        labels,
        np.ascontiguousarray(range_m),
        evidence.above_m[lines],
        evidence.texture[strip_lines],
        evidence.neighbours.of_lines(lines),
        evidence.strips.slots.of_lines(strip_lines),
        evidence.strips.walls.of_lines(strip_lines),
        plane.beams,
        plane.step_rad,
        _GROUPS,
        _rows(tuple(questions.items())),
        _STEPS,
    )
    return cells


def confidence_of(labels: U8, cells: I32, table: U8) -> U8:
    """Return the confidence of every shot.

    ``labels`` (...) uint8; ``cells`` (...) int32; ``table`` (number of labels, cells) uint8;
    returns (...) uint8.

    >>> table = np.zeros((12, 4), np.uint8)
    >>> table[Label.GROUND] = 60, 70, 80, 90
    >>> confidence_of(np.array([[3, 0]], np.uint8), np.array([[2, 1]], np.int32), table)
    array([[80,  0]], dtype=uint8)
    """
    confidence: U8 = table.ravel()[labels.astype(np.intp) * table.shape[1] + cells]
    return confidence


def of_further_returns(block: ScanBlock, confidence: U8, limit_m: float) -> U8:
    """Return the confidence of further returns, (n,) uint8: that of the shot whose label they take.

    0 if they take none.
    """
    further = block.extra
    return label_extra_returns(
        block.range_m,
        confidence,
        further.line,
        further.column,
        further.range_m,
        limit_m,
        limit_m,
        alone=Label.MISSING,
    )


@cache
def load_table(environment: Environment) -> U8:
    """Return the confidence of every label and cell, (number of labels, cells) uint8 [per cent]."""
    stored: dict[str, str] = json.loads(TABLE.read_text(encoding="utf-8"))[environment]
    table = np.zeros((len(Label), N_CELLS), np.uint8)
    for name, text in stored.items():
        table[Label[name.upper()]] = np.frombuffer(bytes.fromhex(text), np.uint8)
    return table


def save_tables(tables: Mapping[Environment, U8]) -> None:
    """Write :data:`TABLE`: two hexadecimal digits a cell."""
    stored: dict[str, dict[str, str]] = {
        place: {label.name.lower(): table[label].tobytes().hex() for label in QUESTIONS[place]}
        for place, table in tables.items()
    }
    TABLE.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
    load_table.cache_clear()


_GROUPS = np.array([GROUPS.get(label, -1) for label in Label], np.int64)
_STEPS = np.array(list(MEASURES.values()), np.float32)


@cache
def _rows(questions: tuple[tuple[Label, tuple[str, ...]], ...]) -> I64:
    """Return the rows of the measures of every label, (number of labels, questions) int64."""
    names = list(MEASURES)
    rows = np.zeros((len(Label), N_QUESTIONS), np.int64)
    for label, asked in questions:
        rows[label] = [names.index(name) for name in asked]
    return rows


UNKNOWN_M = 1e6
"""Heights beyond are those of places where no ground was seen [m]."""
_LEAST_SHARE = 0.5
"""Beams less than 30 degrees from level do not show the tilt of the plane."""


def true_heights(above_m: F32, block: ScanBlock) -> F32:
    """Return heights in metres from heights in the scan plane.

    They are the same if the plane is upright, or its tilt is not known.

    ``above_m`` (lines, M) float32; returns (lines, M) float32.
    """
    known = np.where(above_m < np.float32(UNKNOWN_M), above_m, np.float32(np.nan))
    cosine_of_tilt = 1.0
    if block.xyz_m is not None and block.beam_rad is not None:
        down = np.cos(block.beam_rad)
        steep = np.abs(down) > _LEAST_SHARE
        in_plane = block.range_m[:, steep].astype(np.float64) * down[steep]
        ratio = -block.xyz_m[:, steep, 2] / in_plane
        ratio = ratio[np.isfinite(ratio)]
        if len(ratio):
            cosine_of_tilt = min(float(np.median(ratio)), 1.0)
    heights: F32 = (known * np.float32(cosine_of_tilt)).astype(np.float32, copy=False)
    return heights
