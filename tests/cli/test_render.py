"""``prc render`` on the command line."""

import pytest

from tests.street import street, write_npz


@pytest.fixture
def drive(tmp_path):
    return write_npz(tmp_path / "drive.npz", street())


def test_a_picture_replaces_another_if_asked(prc, drive, tmp_path):
    (tmp_path / "a.png").write_bytes(b"old")
    assert prc(f"render {drive} {tmp_path}/a.png --overwrite").code == 0
