from __future__ import annotations

from pathlib import Path

import pytest

from prc_cli.core.errors import InputError
from prc_cli.matching.pairs import pair_files


def fill(folder: Path, *names: str) -> Path:
    folder.mkdir()
    for name in names:
        (folder / name).touch()
    return folder


def test_two_files_are_a_pair_whatever_their_names(tmp_path: Path) -> None:
    assert pair_files(Path("a.npy"), Path("b.las")) == ((Path("a.npy"), Path("b.las")),)


def test_folders_pair_by_name_without_suffix(tmp_path: Path) -> None:
    left = fill(tmp_path / "run", "b.1.npy", "a.npy", "a.npy.prc.json", ".c.npy", "notes.md")
    right = fill(tmp_path / "reference", "a.csv.gz", "b.1.LABEL", "README")
    (right / "more.npy").mkdir()
    assert pair_files(left, right) == ((left / "a.npy", right / "a.csv.gz"), (left / "b.1.npy", right / "b.1.LABEL"))


@pytest.mark.parametrize(
    ("run", "reference", "message"),
    [
        (("a.npy",), ("a.csv", "b.csv"), "reference: 1 file has no partner in .*run: b; give partners"),
        (("a.npy", "b.npy"), ("a.csv",), "run: 1 file has no partner in .*reference: b"),
        (("a.npy", "a.csv"), ("a.las",), "run: a.csv and a.npy have one name"),
        ((), ("a.las",), "run: no files with class codes in it"),
        (("a.txt.md",), ("a.las",), "run: no files with class codes in it"),
    ],
)
def test_folders_that_do_not_fit(tmp_path: Path, run: tuple[str], reference: tuple[str], message: str) -> None:
    left, right = fill(tmp_path / "run", *run), fill(tmp_path / "reference", *reference)
    with pytest.raises(InputError, match=message):
        pair_files(left, right)


def test_a_file_against_a_folder(tmp_path: Path) -> None:
    folder = fill(tmp_path / "run", "a.npy")
    with pytest.raises(InputError, match="a.npy: a file against the folder .*run; give two files or two folders"):
        pair_files(folder, folder / "a.npy")
    with pytest.raises(InputError, match="nowhere: no such folder"):
        pair_files(tmp_path / "nowhere", folder)
