"""The night's report of a batch that is compared with references: totals, files, nights, pictures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes
from prc_cli.jobs.batch.run import run_batch
from prc_cli.jobs.batch.types import BatchSettings, ConfigLayers, ReferenceSettings
from prc_cli.jobs.classify import classify_ranges
from tests.street import street, write_npz


@pytest.fixture
def settings(tmp_path: Path) -> BatchSettings:
    """Two drives; half of the second one's reference is wrong."""
    for folder in ("archive", "ref"):
        (tmp_path / folder).mkdir()
    for name, seed in (("a", 1), ("b", 2)):
        image = street(seed=seed)
        write_npz(tmp_path / "archive" / f"{name}.npz", image)
        codes = ClassCodes().lookup()[classify_ranges(image, load_config(preset="urban")).labels]
        if name == "b":
            codes[: len(codes) // 2] = np.where(codes[: len(codes) // 2] > 0, 6, 0)
        np.save(tmp_path / "ref" / f"{name}.npy", codes.ravel())
    layers = ConfigLayers(preset="urban", options={"input": {"accept_doubts": ["method"]}})
    reference = ReferenceSettings(tmp_path / "ref", "prc", gates=("accuracy=0.99",))
    return BatchSettings(tmp_path / "archive", tmp_path / "out", layers, jobs=1, reference=reference, drift=False)


def test_a_night_is_told_beside_those_before(settings: BatchSettings) -> None:
    summary = run_batch(settings)
    assert summary.evaluation is not None
    page = (settings.out / "report.html").read_text(encoding="utf-8")
    # the worst file comes first, with its pictures
    rows = page.partition("Files, the worst first")[2]
    assert 0 < rows.index("<td>b.npz</td>") < rows.index("<td>a.npz</td>")
    assert page.count("<figure>") == 6
    assert "2 files classified" in page
    assert "badge failed" in page
    assert "<h2>Nights</h2>" not in page
    run_batch(settings)
    page = (settings.out / "report.html").read_text(encoding="utf-8")
    assert "0 files classified, 2 done before" in page
    assert "<h2>Nights</h2>" in page
    nights = json.loads((settings.out / ".prc" / "nights.json").read_text(encoding="utf-8"))
    assert len(nights) == 2
    assert nights[0]["f1"] == nights[1]["f1"]
    # a damaged file of nights begins anew
    (settings.out / ".prc" / "nights.json").write_text("[")
    run_batch(settings)
    assert len(json.loads((settings.out / ".prc" / "nights.json").read_text(encoding="utf-8"))) == 1
