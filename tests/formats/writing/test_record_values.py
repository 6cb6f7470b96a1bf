"""Records in a temporary file, read in any order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.formats.writing import disk as record_values
from prc_cli.formats.writing.disk import RecordValues


def test_records_far_apart_are_read_page_by_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record_values, "PAGE_RECORDS", 8)
    values = RecordValues(tmp_path / "values", np.dtype("<i4"), -5)
    values.append(np.arange(1000, dtype=np.int32) * 3)
    wanted = np.array([990, 1, -1, 2, 500, 1000, 7, 8, 501, 1])
    held = (wanted >= 0) & (wanted < 1000)
    assert np.array_equal(values.get(wanted), np.where(held, wanted * 3, -5))
    values.close()
