"""Recorded scan angles that are cut off or of another scale: x, y, z and the other columns tell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from prc_cli.core.findings import Verdict
from prc_cli.core.stream import ScanStream
from prc_cli.core.types import F64
from prc_cli.streams.agreement import contradicted_share
from prc_cli.streams.evidence.checks import check_coordinates
from prc_cli.streams.evidence.figures import Seen
from tests.streams.record_lists import open_records

M = 320
TRUE = np.deg2rad(np.linspace(-160, 159, M))


def walls(n_lines: int = 40) -> tuple[F64, F64]:
    """Ranges and registered points between two walls, of a scanner that drives and leans over."""
    line = np.arange(n_lines)[:, None]
    angle = TRUE[None, :]
    reach = np.minimum(
        4 / np.maximum(np.abs(np.sin(angle)), 1e-6), 2 / np.maximum(np.abs(np.cos(angle)), 1e-6)
    )
    reach = np.where(np.abs(angle) > np.deg2rad(120), np.nan, reach)
    range_m = np.broadcast_to(reach, (n_lines, M)).copy()
    lean = 0.3 * np.sin(line / 7)
    along = np.broadcast_to(0.2 * line, range_m.shape)
    xyz = np.stack(
        [along, range_m * np.sin(angle + lean), -range_m * np.cos(angle + lean)], axis=-1
    )
    return range_m, xyz + np.array([300.0, 5000.0, 12.0])


@pytest.mark.parametrize(
    ("range_of", "angle_of", "is_right"),
    [
        (np.copy, np.copy, True),
        (np.copy, lambda a: np.deg2rad(np.round(np.rad2deg(a))), True),
        (np.copy, lambda a: 1.67 * a, False),
        (np.copy, lambda a: 0.5 * a, False),
        (np.copy, lambda a: np.clip(a, -np.pi / 2, np.pi / 2), False),
        (np.copy, np.abs, True),
        (lambda r: 3.28 * r, np.copy, False),
        (lambda r: 0.1 * r, np.copy, False),
    ],
)
def test_points_contradict_wrong_ranges_and_angles(
    range_of: Any, angle_of: Any, is_right: bool
) -> None:
    range_m, xyz = walls()
    line, column = (index.ravel() for index in np.indices(range_m.shape))
    share = contradicted_share(
        range_of(range_m.ravel()), xyz.reshape(-1, 3), line, column, angle_of(TRUE)
    )
    assert share is not None
    assert (share < 0.1) == is_right


def drive(range_m: F64, xyz: F64, angle_rad: F64) -> ScanStream:
    """The walls as a list of records."""
    line, column = (index.ravel() for index in np.indices(range_m.shape))
    values = {
        "range": range_m.ravel(),
        "scan_line": line,
        "column": column,
        "angle": angle_rad[column],
    }
    values |= {axis: xyz[..., i].ravel() for i, axis in enumerate("xyz")}
    return open_records(values, 5000)


SCALES = [
    ("right", np.copy, "", True),
    ("cut off", lambda a: np.clip(a, -np.pi / 2, np.pi / 2), "cut off at", True),
    ("hundredths", lambda a: 0.6 * a, "contradict range and scan angle", False),
    ("without sign", np.abs, "run back", False),
]


@pytest.mark.parametrize(
    ("angle_of", "note_part", "has_angles"),
    [case[1:] for case in SCALES],
    ids=[case[0] for case in SCALES],
)
def test_angles_that_are_not_those_of_the_shots_are_not_used(
    angle_of: Any, note_part: str, has_angles: bool
) -> None:
    range_m, xyz = walls()
    info = drive(range_m, xyz, angle_of(TRUE)).info
    assert (info.angle_rad is not None) == has_angles
    if info.angle_rad is not None:
        np.testing.assert_allclose(info.angle_rad, TRUE, atol=1e-6)
    notes = [note for note in info.facts.notes if "scan angle" in note]
    assert len(notes) == bool(note_part)
    assert not note_part or note_part in notes[0]


def test_a_range_that_is_none_is_doubted() -> None:
    range_m, xyz = walls()
    height = xyz[..., 2] - np.nanmin(xyz[..., 2]) + 1.0
    finding = check_coordinates(Seen(drive(height, xyz, TRUE).info, 0, ()))
    assert finding is not None
    assert finding.verdict is Verdict.DOUBTFUL
    assert "--range dimension:NAME" in finding.hint
    assert check_coordinates(Seen(drive(range_m, xyz, TRUE).info, 0, ())) is None
