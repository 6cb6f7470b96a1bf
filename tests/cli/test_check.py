"""``prc check`` and ``prc evaluate CLASSIFIED ANSWERS`` on the command line."""

import json
import re
from pathlib import Path

import numpy as np

from tests.street import street, write_npz


def test_two_persons(prc, tmp_path, monkeypatch):
    """All answer as predicted, but one of them differs in five places."""
    monkeypatch.chdir(tmp_path)
    ranges = street()
    write_npz(Path("drive.npz"), ranges)
    labels = np.where(np.isnan(ranges), 0, np.where(ranges < 6, 2, 6))
    np.save("labels.npy", labels.astype(np.uint8).ravel())
    assert prc("check drive.npz c.html --labels labels.npy --shots 50").code == 0
    (about,) = re.findall(r'id="about">(.*?)</script>', Path("c.html").read_text("utf-8"), re.S)
    answers = json.loads(about)["answers"]
    for person, n_other in (("Ada", 0), ("Ben", 5)):
        answers["person"] = person
        for number, place in enumerate(answers["places"]):
            predicted = answers["strata"][place["stratum"]]["predicted"]
            place["answer"] = "other" if number < n_other else predicted
        Path(f"{person}.json").write_text(json.dumps(answers))
    alone = prc("evaluate labels.npy Ada.json").out
    assert "accuracy 1.000" in alone
    both = prc("evaluate labels.npy Ada.json Ben.json").out
    assert "Ada and Ben agree on 90.0% of 50 places" in both
    assert "from 50 answers" in both
