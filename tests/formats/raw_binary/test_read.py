"""Raw dumps: any layout, any chunks, and every way a file can be cut short."""

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.options import RANGES_ONLY, Layout, LayoutField
from prc_cli.formats.raw_binary.read import RawBinarySource

WIDE = Layout(
    header_bytes=5,
    endian="big",
    record_bytes=24,
    fields=(
        LayoutField(name="flags", type="u1"),
        LayoutField(name="range", type="u4", scale=0.001, missing=0),
        LayoutField(name="angle", type="f4", unit="deg"),
        LayoutField(name="time", type="f8"),
        LayoutField(name="column", type="u2"),
    ),
)


@pytest.mark.parametrize(
    "content, message",
    [
        (b"", "the file is empty (0 bytes), expected records of 24 bytes"),
        (b"HEA", "found 3 bytes, fewer than the header of 5 bytes; check layout.header_bytes"),
        (b"HEAD\n", "no bytes follow the header of 5 bytes, expected records of 24 bytes"),
        (b"HEAD\n" + bytes(23), "byte 5 (record 0): found 23 bytes, expected a record of 24 bytes"),
        (
            b"HEAD\n" + bytes(24 * 3 + 1),
            "byte 77 (record 3): found 1 bytes, expected a record of 24 bytes",
        ),
    ],
)
def test_short_files_are_refused_when_opened(tmp_path, content, message):
    path = tmp_path / "short.raw"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        RawBinarySource(path, WIDE)
    assert str(caught.value).startswith(f"{path}: {message}")
    assert "\n" not in str(caught.value)


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
