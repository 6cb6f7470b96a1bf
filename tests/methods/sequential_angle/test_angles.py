"""Angles of chords, and the table of keys."""

import re
from pathlib import Path

import numpy as np

from prc_cli.core.config import flatten
from prc_cli.methods.sequential_angle.angles import signed_angles
from prc_cli.methods.sequential_angle.pipeline import SequentialAngleParams
from prc_cli.methods.sequential_angle.thresholds import ChordThresholds
from tests.methods.sequential_angle.scenes import lines_through, made


def plain(**values: float) -> ChordThresholds:
    """Without the readings that are ours, so that every rule is tested by itself."""
    return made(ChordThresholds, **values).at_noise()


def test_chords_bridge_missing_shots_and_short_steps():
    gap = (np.nan, np.nan)
    points = [(4, -2), gap, gap, (4.5, -2), (4.51, -2), (4.519, -2), gap, (4.52, -2), (4.6, -1.9)]
    angles = signed_angles(lines_through(points), plain())
    assert angles.ahead[0].tolist() == [3, -1, -1, 8, 8, 8, -1, 8, -1]
    assert np.array_equal(np.isnan(angles.signed_deg), angles.ahead < 0)
    # a chord is as long as the shortest allowed or longer
    whole = plain(range_noise_m=0.0625)
    angles = signed_angles(lines_through([(4, -2), (4.25, -2), (4.5, -2)]), whole)
    assert angles.ahead[0].tolist() == [1, 2, -1]


PAGE = (Path(__file__).resolve().parents[3] / "design" / "sequential_angle.md").read_text(
    encoding="utf-8"
)
VALUES = dict(flatten(SequentialAngleParams().model_dump()))


def documented() -> dict[str, str]:
    """Keys and defaults of the table of constants.

    a row a table, cells of "`key` default (note)".
    """
    section = PAGE[PAGE.index("## Constants") : PAGE.index("## Beside Table 1")]
    published = {}
    for table, cells in re.findall(r"^\| (?:`([a-z_.]+)`)? ?\|(.*)\|$", section, re.MULTILINE):
        for key, default in re.findall(r"`([a-z0-9_]+)`,? ([^;|(`]*)", cells):
            published[f"{table}.{key}".lstrip(".")] = default.strip().replace("−", "-")
    return published


def test_the_table_names_every_default_and_no_other_key():
    table = documented()
    assert table.keys() <= VALUES.keys()
    for key, value in VALUES.items():
        if isinstance(value, tuple) and isinstance(value[0], float):
            assert table[key] == ", ".join(f"{number:g}" for number in value), key
        elif isinstance(value, bool):
            assert table[key] == str(value).lower(), key
        elif isinstance(value, int | float):
            assert float(table[key]) == value, key
