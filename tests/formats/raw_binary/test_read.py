"""Raw dumps: any layout, any chunks, and every way a file can be cut short."""

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.options import RANGES_ONLY
from prc_cli.formats.raw_binary.read import RawBinarySource


def test_a_file_that_shrinks_while_it_is_read(tmp_path):
    path = tmp_path / "shrinks.bin"
    np.arange(1, 11, dtype=np.float32).tofile(path)
    source = RawBinarySource(path, RANGES_ONLY, 4)
    chunks = source.chunks(("range",))
    next(chunks)
    path.write_bytes(path.read_bytes()[:25])
    with pytest.raises(InputError) as caught:
        list(chunks)
    assert "byte 24 (record 6): the file ends, expected 10 records as when opened" in str(
        caught.value
    )
