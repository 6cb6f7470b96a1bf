"""``prc check`` and ``prc evaluate CLASSIFIED ANSWERS`` on the command line."""

from pathlib import Path

import numpy as np

from tests.golden.inputs import answer
from tests.street import street, write_npz


def test_two_persons(prc, tmp_path, monkeypatch):
    """All answer as predicted, but one of them differs in five places."""
    monkeypatch.chdir(tmp_path)
    ranges = street()
    write_npz(Path("drive.npz"), ranges)
    labels = np.where(np.isnan(ranges), 0, np.where(ranges < 6, 2, 6))
    np.save("labels.npy", labels.astype(np.uint8).ravel())
    assert prc("check drive.npz c.html --labels labels.npy --shots 50").code == 0
    answer("c.html", "ada.json", "Ada", "0")
    answer("c.html", "ben.json", "Ben", "5")
    assert "accuracy 1.000" in prc("evaluate labels.npy ada.json").out
    both = prc("evaluate labels.npy ada.json ben.json").out
    assert "Ada and Ben agree on 90.0% of 50 places" in both
    assert "from 50 answers" in both
