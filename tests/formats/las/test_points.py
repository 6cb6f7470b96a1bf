"""Bytes of LAS records: where class codes lie and what fits there."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.formats.las.header import standard_bytes
from prc_cli.formats.las.points import set_classes


@pytest.mark.parametrize("form", range(6))
def test_five_bits_hold_code_31_and_not_32(form: int) -> None:
    records = np.full((2, standard_bytes(form)), 0xFF, np.uint8)
    set_classes(records, form, np.array([31, 0], np.uint8))
    assert records[:, 15].tolist() == [0xFF, 0xE0]
    with pytest.raises(ValueError, match=rf"code 32 does not fit the five bits of point format {form}"):
        set_classes(records, form, np.array([2, 32], np.uint8))


@pytest.mark.parametrize("form", range(6, 11))
def test_a_byte_of_its_own_holds_every_code(form: int) -> None:
    records = np.full((2, standard_bytes(form)), 0xFF, np.uint8)
    set_classes(records, form, np.array([32, 255], np.uint8))
    assert records[:, 16].tolist() == [32, 255]
    assert np.all(np.delete(records, 16, axis=1) == 0xFF)
