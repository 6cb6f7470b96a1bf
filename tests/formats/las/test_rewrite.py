"""LAS and LAZ, rewritten and new.

Only the class and requested dimensions change; a record for every return.
"""

import json

import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import InputError
from prc_cli.formats.las.header import standard_bytes
from prc_cli.formats.las.points import set_classes
from tests.formats.common import (
    random_labels,
    record_blocks,
    run_record,
    write,
    writer,
)
from tests.formats.las.lasbytes import (
    EVLRS,
    VLRS,
    classes,
    field,
    make_las,
    parse,
    same_but_class,
)


@pytest.mark.parametrize("before, after", [(".las", ".laz"), (".laz", ".las")])
@pytest.mark.parametrize("form", range(11))
def test_only_the_class_changes(
    tmp_path,
    form,
    before,
    after,
):
    source = tmp_path / f"in{before}"
    output = tmp_path / f"out{after}"
    minor = 4 if form in (1, 5, 6, 7, 8, 9, 10) else None
    old = make_las(
        source,
        form,
        minor=minor,
        seed=form,
        vlrs=VLRS,
        evlrs=EVLRS if minor == 4 else (),
        user_bytes=b"between VLRs and points",
        header_user_bytes=b"own header bytes",
        raw_points=True,
    )
    labels = random_labels(300)
    write(output, source, record_blocks(labels))
    new = parse(output)
    same_but_class(old, new)
    assert np.array_equal(classes(new), ClassCodes().lookup()[labels])
    assert len(new.record_payloads()) == 1
    assert bool(new.header[104] & 0x80) == (after == ".laz")
    if minor == 4:
        assert field(new.data, 235, "Q") == len(new.data) - len(new.tail)
        assert field(new.data, 243, "I") == 2


def test_a_changed_input_is_noticed(tmp_path):
    source = tmp_path / "in.las"
    make_las(source, 6)
    with writer(tmp_path / "out.las", source) as opened:
        make_las(source, 6, n=301)
        with pytest.raises(InputError, match="found another header than at the start of the run"):
            opened.finish(run_record())


def test_a_record_too_long_for_a_vlr_is_shortened_there_only(tmp_path):
    source = tmp_path / "in.las"
    output = tmp_path / "out.las"
    make_las(source, 6)
    record = run_record(config={"key": "x" * 70_000})
    write(output, source, record_blocks(random_labels(300)), record)
    inside = json.loads(parse(output).record_payloads()[0])
    assert inside["complete"] is False
    assert len(inside["config_sha256"]) == 64
    assert json.loads((tmp_path / "out.las.prc.json").read_text())["config"]["key"] == "x" * 70_000


@pytest.mark.parametrize("form", range(6))
def test_five_bits_hold_code_31_and_not_32(form):
    records = np.full((2, standard_bytes(form)), 0xFF, np.uint8)
    set_classes(records, form, np.array([31, 0], np.uint8))
    assert records[:, 15].tolist() == [0xFF, 0xE0]
    with pytest.raises(
        ValueError, match=rf"code 32 does not fit the five bits of point format {form}"
    ):
        set_classes(records, form, np.array([2, 32], np.uint8))
