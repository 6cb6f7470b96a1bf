"""Error codes among the ranges, and coordinates of another frame."""

import numpy as np

from prc_cli.core.stream import StreamInfo
from prc_cli.streams.evidence.checks import check_missing_code, check_ranges
from prc_cli.streams.evidence.figures import Seen, Window


def seen(range_m: np.ndarray) -> Seen:
    windows = [Window(0, range_m.astype(np.float32))]
    info = StreamInfo("a", "array", range_m.shape[1], None, None)
    return Seen(
        info=info,
        scanner=0,
        windows=windows,
        n_lines=len(range_m),
        n_shots=range_m.size,
        n_missing=0,
    )


def test_millimetres_of_error_codes_are_doubted_with_the_least_range():
    rng = np.random.default_rng(1)
    range_m = rng.uniform(2, 30, (100, 100))
    range_m[rng.random(range_m.shape) < 0.2] = 0.012
    finding = check_missing_code(seen(range_m))
    assert finding is not None
    assert finding.verdict
    assert finding.option == "--set input.min_range=0.05"


def test_a_place_far_from_the_origin_is_not_offered_millimetres():
    finding = check_ranges(seen(np.random.default_rng(1).uniform(400, 520, (100, 100))))
    assert finding is not None
    assert "origin:X,Y,Z" in finding.hint
    assert not finding.option
