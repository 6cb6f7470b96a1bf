"""Snow, rain and fog are no disorder."""

import numpy as np

from prc_cli.core.facts import SourceFacts
from prc_cli.core.findings import Verdict
from prc_cli.core.stream import StreamInfo
from prc_cli.core.types import F32
from prc_cli.streams.evidence.checks import ask_all
from prc_cli.streams.evidence.figures import Seen, Window, without_lonely
from tests.methods.rings.test_rings import N_RINGS, scene


def drive() -> F32:
    """Turns of a scanner in a street."""
    return np.concatenate([scene(seed)[0] for seed in (1, 2)])


def verdicts_of(range_m: F32, *, has_rings: bool = True) -> dict[str, Verdict]:
    info = StreamInfo("a.npz", "array", N_RINGS, None, len(range_m), facts=SourceFacts())
    windows = tuple(
        Window(first, range_m[first : first + 900]) for first in range(0, len(range_m), 900)
    )
    seen = Seen(
        info,
        0,
        windows,
        len(range_m),
        range_m.size,
        int(np.isnan(range_m).sum()),
        has_rings=has_rings,
    )
    return {finding.check: finding.verdict for finding in ask_all(seen)}


def test_shuffled_lines_and_shots_are_disorder_all_the_same():
    random = np.random.default_rng(1)
    lines = random.permutation(drive())
    assert verdicts_of(lines)["line-order"] is Verdict.AGAINST
    shots = random.permutation(drive().ravel()).reshape(-1, N_RINGS)
    assert verdicts_of(shots)["shot-order"] > Verdict.FINE
    assert without_lonely((Window(0, shots),)) is None
