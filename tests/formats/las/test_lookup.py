"""The Classification Lookup VLR: names of user codes in LAS and LAZ files."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest
from laspy.vlrs.known import ClassificationLookupVlr

from prc_cli.core.classes import Label
from prc_cli.core.stream import LabelledBlock
from prc_cli.formats.las.vlrs import names_of_file
from tests.formats.common import labelled, write
from tests.formats.las.lasbytes import make_las, parse

N = 300
NAMES = {64: "stem", 65: "car"}


def entries(path: Path) -> dict[int, str]:
    """The names as laspy reads them."""
    found = [vlr for vlr in laspy.read(path).header.vlrs if isinstance(vlr, ClassificationLookupVlr)]
    assert len(found) <= 1
    return dict(found[0].lookups) if found else {}


def stems(n: int = N) -> list[LabelledBlock]:
    labels = np.full((n // 20, 20), Label.STEM, np.uint8)
    return [labelled(labels)]


def named(path: Path, data: bytes) -> Path:
    """A LAS file that names classes itself."""
    las = laspy.create(point_format=6, file_version="1.4")
    las.x = np.arange(N)
    las.header.vlrs.append(laspy.VLR("LASF_Spec", 0, "of the makers", data))
    las.write(path)
    return path


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_new_files_hold_the_names(tmp_path: Path, suffix: str) -> None:
    write(tmp_path / f"a{suffix}", Path("drive.bin"), stems(), user_names=NAMES)
    assert entries(tmp_path / f"a{suffix}") == NAMES
    write(tmp_path / f"b{suffix}", Path("drive.bin"), stems(), user_names={})
    assert entries(tmp_path / f"b{suffix}") == {}


@pytest.mark.parametrize("form", [1, 6])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_copies_hold_them_and_all_else_stays(tmp_path: Path, form: int, suffix: str) -> None:
    make_las(tmp_path / f"in{suffix}", form)
    write(tmp_path / f"out{suffix}", tmp_path / f"in{suffix}", stems(), user_names=NAMES)
    write(tmp_path / f"plain{suffix}", tmp_path / f"in{suffix}", stems(), user_names={})
    assert entries(tmp_path / f"out{suffix}") == NAMES
    out, plain = parse(tmp_path / f"out{suffix}"), parse(tmp_path / f"plain{suffix}")
    ours = [vlr for vlr in out.vlrs if vlr[2:].startswith(b"LASF_Spec\0") and vlr[18:20] == b"\0\0"]
    assert len(ours) == 1
    assert ours[0][54:] == b"".join(struct.pack("<B15s", code, name.encode()) for code, name in NAMES.items())
    assert [vlr for vlr in out.kept_vlrs() if vlr not in ours] == plain.kept_vlrs()
    assert out.records.tobytes() == plain.records.tobytes()


def test_names_of_the_input_are_kept_and_joined(tmp_path: Path) -> None:
    before = struct.pack("<B15sB15sB15s", 70, b"Rail \xe4", 65, b"car", 65, b"again")
    source = named(tmp_path / "in.laz", before)
    record = write(tmp_path / "out.laz", source, stems(), user_names=NAMES)
    after = next(vlr for vlr in parse(tmp_path / "out.laz").vlrs if vlr[18:20] == b"\0\0" and b"LASF_Spec" in vlr[:20])
    assert after[54:] == before + struct.pack("<B15s", 64, b"stem")
    assert after[22:54].startswith(b"of the makers")
    assert not [one for one in record.notices if "named" in one]
    assert names_of_file(tmp_path / "out.laz")[64] == "stem"
    # what names them all already stays as it is
    write(tmp_path / "again.laz", tmp_path / "out.laz", stems(), user_names=NAMES)
    assert parse(tmp_path / "again.laz").kept_vlrs() == parse(tmp_path / "out.laz").kept_vlrs()


def test_another_name_gives_way_and_is_told(tmp_path: Path) -> None:
    source = named(tmp_path / "in.las", struct.pack("<B15s", 64, b"Rail"))
    record = write(tmp_path / "out.las", source, stems(), user_names=NAMES)
    assert entries(tmp_path / "out.las") == NAMES
    assert "class 64 was named 'Rail' in the input; its name is now 'stem'" in record.notices
