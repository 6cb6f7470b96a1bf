"""``[output] stages``: what a method without intermediate results adds to an output."""

from pathlib import Path

import numpy as np
import pytest

from prc_cli.formats.writing.columns import OutputConfig
from tests.formats.common import random_labels, record_blocks, write
from tests.formats.las.lasbytes import parse

SOURCE = Path("drive.bin")
STAGES = OutputConfig(stages=True)
NOTICE = "output.stages needs the fused, prc or sequential-angle method; nothing was added"
NO_ROOM = "a .npy output holds class codes only; stages need .csv, .parquet, .las or .laz"


@pytest.mark.parametrize("suffix", [".laz", ".csv", ".parquet", ".npy"])
def test_a_method_without_stages_adds_nothing(tmp_path, suffix):
    """The output is that of a run without the option, but for a notice in the run's record."""
    blocks = record_blocks(random_labels(300))
    asked = tmp_path / f"asked{suffix}"
    plain = tmp_path / f"plain{suffix}"
    record = write(asked, SOURCE, blocks, options=STAGES)
    write(plain, SOURCE, blocks)
    notices = [text for text in record.notices if "stages" in text]
    assert notices == [NO_ROOM if suffix == ".npy" else NOTICE]
    if suffix == ".laz":
        assert np.array_equal(parse(asked).records, parse(plain).records)
    else:
        assert asked.read_bytes() == plain.read_bytes()
