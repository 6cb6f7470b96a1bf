"""The classes that were marked by hand in a real drive."""

import numpy as np

from benchmarks.labels import CODES, marked

KINDS = [(name, "f4") for name in ("theta", "y", "z", "y_origin", "z_origin")]


def test_marked_classes():
    """Road, lamp, facade, and a room behind a pane, which is not judged."""
    table = np.zeros(4, KINDS)
    table["y"] = [0.0, -9.0, -12.0, -14.0]
    table["z"] = [-2.4, 1.0, 5.0, 3.5]
    names = ("ground", "pole", "building", "unsure")
    assert marked(table).tolist() == [CODES[name] for name in names]


def test_marked_turns():
    """The lamp is seen in the first eight turns; later returns there are unsure."""
    table = np.zeros(40, KINDS)
    table["theta"] = np.tile([-2.0, 2.0], 20)
    table["y"], table["z"] = -9.0, 1.0
    assert np.flatnonzero(marked(table) == CODES["pole"]).tolist() == list(range(16))
