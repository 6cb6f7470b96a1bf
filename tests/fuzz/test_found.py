"""Regression tests for faults found by campaigns and by hand, each with the smallest file that
shows it."""

import contextlib
import json
import os
import sqlite3
import struct
import sys
import time
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.cli import _run
from prc_cli.core.config import MAX_TOML_BYTES, read_toml
from prc_cli.core.errors import ConfigError
from tests.fuzz.guard import unprintable
from tests.fuzz.seeds import seed
from tests.messages import folded

URBAN = ("--preset", "prc-2019-urban", "--trust-order")


def put(path: Path, content: bytes | str) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def run(capfd: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str]:
    """Exit code, and what was printed on both streams."""
    try:
        code = _run([str(argument) for argument in arguments], debug=False)
    except SystemExit as left:  # as ``main`` would hand it on
        code = int(left.code or 0)
    sys.stdout.flush()
    printed = capfd.readouterr()
    return code, printed.out + printed.err


@pytest.mark.parametrize(
    "text, message",
    [
        ("a = " + "[" * 100_000, "too deep"),
        ("a = " + "{b = " * 5_000, "too deep"),
        ("a." * 100_000 + "b = 1", "line 1: a key of more than 64 parts"),
        ("x = 1\n['a'.\"b\" . " + "c." * 80 + "d]", "line 2: a key of more than 64 parts"),
        ("x = {" + "a." * 70 + "a = 1}", "a key of more than 64 parts"),
        ("seed = " + "9" * 5_000, "not valid TOML: Exceeds the limit"),
        ("#" * (MAX_TOML_BYTES + 1), "is longer than 1048576 bytes"),
    ],
)
def test_toml_that_its_parser_cannot_take(tmp_path, text, message):
    path = put(tmp_path / "a.toml", text)
    start = time.process_time()
    with pytest.raises(ConfigError, match=message):
        read_toml(path)
    assert time.process_time() - start < 60


NAMES = [
    "e\x1b[31mvil\x1b]0;x\x07",
    "two\nlines",
    "[bold]x[link=y]:car:",
    "\u202eturned c1\x9b2J",
    os.fsdecode(b"\xff\xfe"),
]


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_names_of_files_command_no_terminal(tmp_path, capfd, name):
    source = put(tmp_path / f"{name}.npz", seed("a.npz"))
    labels = tmp_path / f"{name}.npy"
    config = put(tmp_path / f"{name}.toml", "preset = 'prc-2019-urban'\n")
    for command in (
        ("info", "-v", source, "--trust-order"),
        ("classify", "-v", source, labels, *URBAN),
        ("convert", "-v", source, tmp_path / f"{name}.ply", "--trust-order"),
        ("info", tmp_path / f"{name}.ply", "--trust-order"),
        ("evaluate", labels, labels),
        ("evaluate", labels, labels, "-o", tmp_path / f"{name}.md"),
        ("evaluate", labels, labels, "-o", tmp_path / f"{name}.html"),
        ("config", "check", config),
        ("config", "show", "--config", config),
        ("info", tmp_path / f"{name} is not there.las"),
    ):
        code, printed = run(capfd, *command)
        assert code == ("not there" in str(command[-1])), printed
        assert not unprintable(printed)


def zeroed(content: bytes, number: int, n_zeros: int = 64) -> bytes:
    """Some bytes of the body of a LAZ file become zeros, as a bad block of a disk leaves them."""
    start = struct.unpack_from("<I", content, 96)[0] + 8
    zeros_start = int(np.random.default_rng(number).integers(start, len(content) - n_zeros))
    return content[:zeros_start] + bytes(n_zeros) + content[zeros_start + n_zeros :]


@pytest.mark.parametrize("name, command", [("pf7.laz", "classify"), ("copc7.laz", "transfer")])
def test_damaged_laz_does_not_come_out_damaged(tmp_path, capfd, name, command):
    """Layers that no classifier needs were copied undecoded.

    Laspy refused a quarter of the outputs. ``transfer`` decoded only the layers of the classes.
    """
    sound = put(tmp_path / "sound.laz", seed(name))
    codes = []
    for number in range(12):
        case = put(tmp_path / f"{number}.laz", zeroed(seed(name), number, 30))
        output = tmp_path / f"o{number}.laz"
        if command == "classify":
            code, printed = run(capfd, "classify", case, output, *URBAN, "-q")
            deep, _ = run(capfd, "info", case, "--deep", "-q", "-M", "24")
            assert (deep == 0) == (code == 0), printed
        else:
            words = ("transfer", sound, case, output, "--min-matched", "0", "-q")
            code, printed = run(capfd, *words)
        codes.append(min(code, 1))
        assert output.exists() != bool(code)
        if code:
            assert "error: " in printed
        else:
            assert len(laspy.read(output)) == len(laspy.read(sound))
    assert set(codes) == {0, 1}


NUMBERS = (
    "seconds",
    "cpu_seconds",
    "peak_mib",
    "n_lines",
    "n_shots",
    "n_records",
    "size",
    "mtime_ns",
)


@pytest.mark.parametrize(
    "statement",
    [
        """UPDATE files SET outcome = json_set(outcome, '$.labels', json('[["GROUND", 1e999]]'))""",
        """UPDATE runs SET totals = '{"done": 1e999}'""",
        *(
            f"UPDATE files SET outcome = replace(outcome, '\"{key}\": ', '\"{key}\": 9e999')"
            for key in NUMBERS
        ),
    ],
)
def test_a_journal_with_numbers_without_end(tmp_path, capfd, statement):
    """Infinity is no integer: a traceback."""
    (tmp_path / ".prc").mkdir()
    journal = put(tmp_path / ".prc" / "journal.sqlite", seed("state/.prc/journal.sqlite"))
    with contextlib.closing(sqlite3.connect(journal)) as journal_file:
        journal_file.execute(statement)
        journal_file.commit()
    for words in (("status",), ("status", "--json"), ("clean", "--dry-run")):
        code, printed = run(capfd, "batch", words[0], tmp_path, *words[1:])
        assert code in (0, 1), printed
        assert not code or folded(printed).count("\n") == 1


@pytest.mark.parametrize("word", ["p\ud800", "--quiet=1e9"])
def test_a_command_of_a_last_run_that_is_none(tmp_path, capfd, word):
    (tmp_path / ".prc").mkdir()
    put(tmp_path / ".prc" / "journal.sqlite", seed("state/.prc/journal.sqlite"))
    table = {"schema": 2, "folder": "/", "arguments": [word]}
    put(tmp_path / ".prc" / "command.json", json.dumps(table)).chmod(0o600)
    code, printed = run(capfd, "batch", "retry", tmp_path)
    assert code == 2
    assert "cannot be read: it contains the options of the last run" in printed
