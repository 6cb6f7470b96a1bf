"""Files that were reserved on the disk and never written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.input import Input


def test_a_copy_that_never_ended_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    with path.open("wb") as handle:
        np.lib.format.write_array_header_1_0(
            handle, {"descr": "<f4", "fortran_order": False, "shape": (1 << 20, 1024)}
        )
        handle.truncate(handle.tell() + (1 << 32))
    if getattr(path.stat(), "st_blocks", 1 << 40) * 512 > 1 << 20:
        pytest.skip("this file system has no holes")
    with pytest.raises(InputError, match="the disk stores almost none of its"):
        Input.of(path).check()
