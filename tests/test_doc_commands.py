"""The commands of the documentation run, on small files of the names that it uses.

Above a block of commands that is not run here stands why: ``<!-- not run: reason -->``, or ``<!--
run by FILE -->``. Pages of figures are written by the benchmark that has run their commands."""

import gzip
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.core.errors import OutputExistsError
from tests.runner import runner
from tests.test_docs import PAGES, ROOT

BLOCK = re.compile(
    r"^(?:<!-- ([^\n]*) -->\n)?```(?:console|sh|bash)\n(.*?)^```", re.MULTILINE | re.DOTALL
)
REASON = re.compile(r"(not run: .{10,}|run by (tests/[\w/.]+)|ci: \w+)")
WRITTEN = "<!-- written by"
DONE = (0, 4)
"""Exit codes: done, or done but look at it: the files are small."""


def blocks(path: Path) -> list[tuple[str, str]]:
    """Reason or nothing, and commands, of every block of a page that is written by hand."""
    text = path.read_text(encoding="utf-8")
    return [] if text.startswith(WRITTEN) or path.parent.name == "figures" else BLOCK.findall(text)


def commands(block: str) -> list[str]:
    """Return the lines of a block that are typed."""
    lines = block.replace("\\\n", " ").splitlines()
    asked = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
    return asked or [line for line in lines if line.strip()]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_is_not_run_has_a_reason(path):
    for reason, block in blocks(path):
        if not reason:
            assert all(re.match(r"prc [a-z]", line) for line in commands(block)), (
                f"{path.name}:\n{block}"
            )
            continue
        match = REASON.fullmatch(reason)
        assert match, f"{path.name}: {reason}"
        assert match[2] is None or (ROOT / match[2]).exists(), f"{path.name}: {reason}"


@pytest.fixture(scope="session")
def sandbox(tmp_path_factory):
    """Return a folder with the files that the documentation names, all of the same short drive."""
    folder = tmp_path_factory.mktemp("docs")

    def prc(words: str) -> None:
        result = runner().invoke(
            cli, [word.replace("@", f"{folder}/") for word in shlex.split(words)]
        )
        assert result.exit_code in DONE, f"{words}\n{result.stderr}"

    prc("simulate street @drive.npz --lines 72 --seed 3 --set scanner.points_per_line=2154 -q")
    with np.load(folder / "drive.npz") as drive:
        codes = drive[
            next(name for name in drive.files if name in ("class", "codes", "label", "labels"))
        ]
        ranges = drive["range_m"]
    np.save(folder / "reference.npy", codes.ravel().astype(np.uint8))
    ranges.astype("<f4").tofile(folder / "drive.bin")
    prc("convert @drive.npz @drive.laz -q")
    prc("convert @drive.npz @drive.csv -q")
    prc("convert @drive.laz @drive.las -q")
    (folder / "drive.csv.gz").write_bytes(gzip.compress((folder / "drive.csv").read_bytes(), 1))
    prc("classify @drive.npz @labels.npy -q")
    prc("classify @drive.npz @labels.csv -q")
    prc("classify @drive.laz @out.laz -q")
    for name in ("drive_classified.laz", "classified.laz"):
        shutil.copy(folder / "out.laz", folder / name)
    shutil.copy(folder / "drive.laz", folder / "reference.laz")
    shutil.copy(folder / "drive.npz", folder / "plot.npz")
    shutil.copy(folder / "drive.csv.gz", folder / "plot.csv.gz")
    for record in folder.glob("*.prc.json"):
        record.unlink()
    return folder


RUN = [path for path in PAGES if any(not reason for reason, _ in blocks(path))]


@pytest.mark.slow
@pytest.mark.parametrize("path", RUN, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_run(
    path,
    sandbox,
    tmp_path,
    monkeypatch,
):
    for reason, block in blocks(path):
        if reason:
            continue
        shutil.copytree(sandbox, tmp_path, dirs_exist_ok=True)
        monkeypatch.chdir(tmp_path)
        for command in commands(block):
            words = shlex.split(command, comments=True)[1:]
            target = words.index(">") if ">" in words else None
            result = runner().invoke(cli, words[:target])
            # a page may write a file again, or one that the sandbox has
            if isinstance(result.exception, OutputExistsError):
                result = runner().invoke(cli, [*words[:target], "--overwrite"])
            assert result.exit_code in DONE, f"{command}\n{result.stderr}\n{result.exception}"
            if target is not None:
                Path(words[target + 1]).write_text(result.stdout, encoding="utf-8")
