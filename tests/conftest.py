"""Fixtures that several rooms of the test tree use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def data_folder() -> Path:
    """Folder of the real scans: ``$PRC_DATA``, else ``../shared/data`` beside the checkout."""
    given = os.environ.get("PRC_DATA")
    return Path(given) if given else Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real scans; absent ones skip the test, but fail it where they are required (CI)."""
    folder = data_folder()
    if not folder.is_dir():
        if os.environ.get("PRC_DATA_REQUIRED"):
            pytest.fail(f"PRC_DATA_REQUIRED is set but there are no real scans in {folder}")
        pytest.skip(f"no real scans in {folder}; set PRC_DATA to their folder")
    return folder
