"""The outputs of a run are a set.

Whole, or recognised and replaced by the next run of the same command.
"""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from prc_cli.core import files, paths
from prc_cli.core.errors import OutputExistsError
from prc_cli.core.files import (
    atomic_output,
    left_words,
    prepare_outputs,
    remove_unfinished,
    whole_set,
)

NAMES = ("o.json", "o.csv", "o.html")
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")


@pytest.fixture(autouse=True)
def command():
    paths.begin_command("evaluate")
    files.forget_placed()
    yield
    paths.begin_command("")


def outputs_in(folder: Path) -> list[Path]:
    return [folder / name for name in NAMES]


def write(folder: Path, source: Path, *, overwrite: bool = False) -> None:
    outputs = outputs_in(folder)
    prepare_outputs(*outputs, overwrite=overwrite, inputs=(source,))
    with whole_set():
        for path in outputs:
            with atomic_output(path, overwrite=overwrite) as temporary:
                temporary.write_text(f"new {path.name}")


def killed_at(number: int, work: Callable[[], None]) -> bool:
    """Do some work in a process that dies before its n-th change of a name.

    Return whether it died.
    """
    child = os.fork()
    if child == 0:
        left = [number]

        def dying(call: Callable[..., None]) -> Callable[..., None]:
            def wrapped(*arguments: object, **named: object) -> None:
                left[0] -= 1
                if left[0] < 0:
                    os._exit(9)
                call(*arguments, **named)

            return wrapped

        for name in ("link", "unlink", "replace", "rename"):
            setattr(os, name, dying(getattr(os, name)))
        try:
            work()
        except BaseException:
            os._exit(1)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, 9)
    return code == 9


def contents(folder: Path) -> dict[str, str]:
    return {
        path.name: path.read_text() for path in sorted(folder.iterdir()) if path.name != "in.npy"
    }


WHOLE = {name: f"new {name}" for name in sorted(NAMES)}


def test_the_same_command_finishes_what_a_killed_run_left(tmp_path):
    source = tmp_path / "in.npy"
    source.touch()
    for number in range(2 * len(NAMES)):  # names given, temporary ones removed
        assert killed_at(number, lambda: write(tmp_path, source))
        write(tmp_path, source)
        assert contents(tmp_path) == WHOLE, number
        for path in outputs_in(tmp_path):
            path.unlink()


def test_a_run_that_is_killed_at_its_very_end_shows(tmp_path):
    source = tmp_path / "in.npy"
    source.touch()

    def work() -> None:
        files.keep_proofs()
        write(tmp_path, source)
        Path("x").unlink()  # it is killed here, before drop_proofs

    assert killed_at(2 * len(NAMES) - 1, work)
    write(tmp_path, source)
    assert contents(tmp_path) == WHOLE


def test_a_complete_folder_holds_no_temporary_names(tmp_path, monkeypatch):
    monkeypatch.setattr(files._State, "keeps_proofs", True)
    source = tmp_path / "in.npy"
    source.touch()
    temporary = tmp_path / "unfinished"
    temporary.mkdir()
    write(temporary, source)
    assert len(list(temporary.iterdir())) == len(NAMES) + 1
    files.name_folder(temporary, tmp_path / "whole")
    assert contents(tmp_path / "whole") == WHOLE


@pytest.mark.parametrize("changed", ["command", "input"])
def test_another_command_or_input_replaces_nothing(tmp_path, changed):
    source = tmp_path / "in.npy"
    unrelated = tmp_path / "second.npy"
    source.touch()
    assert killed_at(2, lambda: write(tmp_path, source))
    if changed == "command":
        paths.begin_command("classify")
    with pytest.raises(OutputExistsError, match="left by a killed run of another command or input"):
        write(tmp_path, unrelated if changed == "input" else source)
    assert (tmp_path / "o.json").read_text() == "new o.json"
    write(tmp_path, source, overwrite=True)
    assert contents(tmp_path) == WHOLE


def test_a_file_of_somebody_else_stays(tmp_path):
    source = tmp_path / "in.npy"
    source.touch()
    assert killed_at(1, lambda: write(tmp_path, source))
    (tmp_path / "o.html").write_text("mine")  # after the last one that the run placed
    with pytest.raises(OutputExistsError):
        write(tmp_path, source)
    assert (tmp_path / "o.html").read_text() == "mine"


def test_outputs_that_were_there_are_replaced_only_if_asked_for(tmp_path):
    source = tmp_path / "in.npy"
    number = 0
    source.touch()
    write(tmp_path, source)
    while killed_at(number, lambda: write(tmp_path, source, overwrite=True)):
        with pytest.raises(OutputExistsError):
            write(tmp_path, source)
        write(tmp_path, source, overwrite=True)
        assert contents(tmp_path) == WHOLE
        number += 1
    assert number >= len(NAMES)


def test_of_files_beside_only_those_of_the_run_go(tmp_path):
    output = tmp_path / "o.db3"
    beside = tmp_path / "metadata.yaml"
    beside.write_text("of another bag")

    def work() -> None:
        prepare_outputs(output, overwrite=False, beside=(beside,))
        with atomic_output(output) as temporary:
            temporary.write_text("new")

    assert killed_at(1, work)
    work()
    assert contents(tmp_path) == {"metadata.yaml": "of another bag", "o.db3": "new"}


def test_who_cleans_up_keeps_a_set_that_is_whole(tmp_path):
    source = tmp_path / "in.npy"
    source.touch()
    assert killed_at(4, lambda: write(tmp_path, source))
    remove_unfinished(*outputs_in(tmp_path), keeps_whole=True)
    assert contents(tmp_path) == WHOLE


def test_a_run_that_is_interrupted_at_its_end_takes_its_outputs_back(tmp_path):
    write(tmp_path, tmp_path / "in.npy")
    files.take_back()
    assert not contents(tmp_path)
    assert left_words() == "no output was left behind"


def test_what_replaced_others_stays_and_is_named(tmp_path):
    write(tmp_path, tmp_path / "in.npy")
    files.forget_placed()
    write(tmp_path, tmp_path / "in.npy", overwrite=True)
    files.take_back()
    assert contents(tmp_path) == WHOLE
    assert left_words() == "o.json, o.csv and 1 more are whole and stay"
