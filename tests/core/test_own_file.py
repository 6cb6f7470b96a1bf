"""Small files of our own: whole, and read only where nobody else may change them."""

import os
import stat

import pytest

from prc_cli.core.errors import OutputError
from prc_cli.core.own_file import read_own, refuse_links, who_may_change, write_own

pytestmark = pytest.mark.skipif(os.name != "posix", reason="modes and links")


def test_a_file_is_replaced_and_read_again(tmp_path):
    path = tmp_path / "command.json"
    write_own(path, "old")
    write_own(path, "a\udcff\n", private=True)
    assert read_own(path, 100) == b"a\\udcff\n"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert os.listdir(tmp_path) == ["command.json"]


def test_what_others_may_change_is_not_read(tmp_path):
    path = tmp_path / "a"
    write_own(path, "text")
    path.chmod(0o666)
    assert who_may_change(path) == "its mode is 666"
    with pytest.raises(PermissionError):
        read_own(path, 100)


@pytest.mark.parametrize("content", ["", "longer"])
def test_an_empty_or_long_file_is_not_read(tmp_path, content):
    write_own(tmp_path / "a", content)
    with pytest.raises(OSError, match="no file of at most 5 bytes"):
        read_own(tmp_path / "a", 5)


def test_links_are_not_followed(tmp_path):
    write_own(tmp_path / "a", "text")
    link = tmp_path / "b"
    link.symlink_to("a")
    with pytest.raises(OSError, match="symbolic link"):
        read_own(link, 100)
    with pytest.raises(OutputError):
        refuse_links(tmp_path, link)


def test_a_folder_that_others_only_add_to_is_sound(tmp_path):
    tmp_path.chmod(0o1777)
    assert who_may_change(tmp_path) == "its mode is 1777"
    assert who_may_change(tmp_path, may_add=True) == ""
