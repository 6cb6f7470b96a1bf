"""Recorded scan angles that are cut off or of another scale: x, y, z and the other columns tell."""

import numpy as np
import pytest

from prc_cli.core.findings import Verdict
from prc_cli.core.stream import ScanStream
from prc_cli.core.types import F64
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


@pytest.mark.parametrize(
    "angle_of, note_part, has_angles",
    [
        (np.copy, "", True),
        (lambda a: np.deg2rad(np.round(np.rad2deg(a))), "", True),
        (lambda a: np.clip(a, -np.pi / 2, np.pi / 2), "cut off at", True),
        (lambda a: 0.6 * a, "contradict range and scan angle", False),
        (lambda a: 1.67 * a, "contradict range and scan angle", False),
        (np.abs, "run back", False),
    ],
)
def test_angles_that_are_not_those_of_the_shots_are_not_used(angle_of, note_part, has_angles):
    range_m, xyz = walls()
    info = drive(range_m, xyz, angle_of(TRUE)).info
    assert (info.angle_rad is not None) == has_angles
    if info.angle_rad is not None:
        np.testing.assert_allclose(info.angle_rad, TRUE, atol=1e-6)
    notes = [note for note in info.facts.notes if "scan angle" in note]
    assert len(notes) == bool(note_part)
    assert not note_part or note_part in notes[0]


@pytest.mark.parametrize(
    "range_of, is_doubted",
    [
        (lambda range_m, _: range_m, False),
        (lambda range_m, _: 3.28 * range_m, True),
        (lambda range_m, _: 0.1 * range_m, True),
        (lambda _, xyz: xyz[..., 2] - np.nanmin(xyz[..., 2]) + 1.0, True),
    ],
)
def test_a_range_that_is_none_is_doubted(range_of, is_doubted):
    range_m, xyz = walls()
    finding = check_coordinates(Seen(drive(range_of(range_m, xyz), xyz, TRUE).info, 0, ()))
    assert (finding is not None) == is_doubted
    if finding is not None:
        assert finding.verdict is Verdict.DOUBTFUL
        assert "--range dimension:NAME" in finding.hint
