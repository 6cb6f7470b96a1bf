"""An archive of small mixed files, and runs of ``prc batch`` over it that tests can kill and
inspect."""

import contextlib
import os
import random
import re
import secrets
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from prc_cli.config import LoadedConfig, RunConfig
from prc_cli.core.errors import BusyError
from prc_cli.core.files import is_younger
from prc_cli.jobs.batch.journal import Entry, journal_paths, read_entries
from prc_cli.jobs.batch.outputs import clean
from prc_cli.jobs.batch.types import OWN_FOLDER
from prc_cli.jobs.classify import load_classifier
from prc_cli.jobs.simulate import simulate
from prc_cli.simulation.settings import load_settings
from tests import patience
from tests.patience import HANGS_S

MARK = "PRC_FAULTS_MARK"
"""Environment variable by which a run and all its workers are found again."""
AS_PLAIN_USER = """
import ctypes, os, sys
for capability in (1, 2) if os.getuid() == 0 else ():
    # PR_CAPBSET_DROP: permissions count for root as well
    ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""
ACCEPTED = """
[input]
accept_doubts = ["few-lines"]
"""
RAW = """
[[override]]
match = "**/*.bin"
[override.input]
lines = "fixed"
columns = "order"
range = "dimension:range"
"""
NAMES = (
    "2026/day 1/drive.bin",
    "2026/day 1/drive.npz",
    "2026/day 1/drive.csv",
    "2026/day 2/drive.las",
    "2026/day 2/drive.laz",
    "2026/day 2/new\nline's.laz",
    "2026/day 3/long.laz",
    "rückweg.las",
)
FAST = ("2026/day 1/drive.npz", "2026/day 2/drive.laz", "rückweg.las")


@dataclass(frozen=True)
class Archive:
    """Inputs, and what an undisturbed run makes of them."""

    folder: Path
    config: Path
    whole: dict[str, bytes]
    """Every output, records included, by its name in the output tree."""
    seconds: float
    """Of the undisturbed run."""

    @property
    def names(self) -> set[str]:
        return {
            path.relative_to(self.folder).as_posix()
            for path in self.folder.rglob("*")
            if path.is_file()
        }


def make_archive(folder: Path, names: Sequence[str] = NAMES) -> Archive:
    """Simulate the inputs and classify them undisturbed."""
    load_classifier(
        LoadedConfig(RunConfig())
    )  # how long a run takes is not how long compiling takes
    inputs = folder / "archive"
    config = folder / "archive.toml"
    for number, name in enumerate(NAMES):
        if name not in names:
            continue
        path = inputs / name
        path.parent.mkdir(parents=True, exist_ok=True)
        options = {
            "seed": number + 1,
            "lines": 30 if "long" in name else 10,
            "scanner": {"points_per_line": 1600},
        }
        simulate("street", path, load_settings("street", options=options), threads=2)
        for extra in (*path.parent.glob("*.prc.json"), *path.parent.glob("*_reference.npy")):
            extra.unlink()
    config.write_text(ACCEPTED)
    for raw in inputs.rglob("*.bin.toml"):
        config.write_text(
            ACCEPTED + RAW + "[override.layout]" + raw.read_text().partition("[layout]")[2]
        )
        raw.unlink()
    before = time.monotonic()
    out = folder / "undisturbed"
    Batch(Archive(inputs, config, {}, 0.0), out).ends(0)
    archive = Archive(inputs, config, tree(out), time.monotonic() - before)
    assert len(archive.whole) == 2 * len(names), sorted(archive.whole)
    return archive


def part_of(archive: Archive, folder: Path, names: Sequence[str] = FAST) -> Archive:
    """Copy some of the inputs into an archive of their own, to be harmed."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(archive.folder / name, path)
    whole = {
        name: content for name, content in archive.whole.items() if name.startswith(tuple(names))
    }
    return Archive(folder, archive.config, whole, archive.seconds)


class Batch:
    """A run of ``prc batch`` as a process of its own session."""

    def __init__(
        self,
        archive: Archive,
        out: Path,
        *options: str,
        jobs: int = 1,
        plain_user: bool = False,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.out = out
        self._mark = secrets.token_hex(8)
        self.process = patience.popen(
            [
                sys.executable,
                *(["-c", AS_PLAIN_USER] if plain_user else []),
                "-m",
                "prc_cli",
                "batch",
                *map(str, (archive.folder, out, "--jobs", jobs, "--config", archive.config)),
                *options,
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="surrogateescape",
            start_new_session=True,
            env={**os.environ, MARK: self._mark, **(environment or {})},
        )

    def members(self) -> list[int]:
        """Return all living processes of the run."""
        members = []
        for path in Path("/proc").iterdir():
            if path.name.isdecimal():
                with contextlib.suppress(OSError):
                    if self._mark.encode() in (path / "environ").read_bytes():
                        members.append(int(path.name))
        return members

    def workers(self) -> list[int]:
        """Return all living processes of the run but the first, and the one that does its work."""
        own_pids = {self.process.pid, self.work()}
        return [pid for pid in self.members() if pid not in own_pids]

    def work(self) -> int:
        """Return the process that does the work: the first one, or the child that it guards."""
        pid = self.process.pid
        with contextlib.suppress(OSError, ValueError, IndexError):  # before it forks, or gone
            return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])
        return pid

    def strike(self, number: int = signal.SIGKILL) -> bool:
        """Send a signal to the first process alone; tell whether it was still running."""
        running = self.process.poll() is None
        if running:
            self.process.send_signal(number)
        return running

    def strike_all(self) -> bool:
        """Kill every process of the run, as far as that can be done at one moment."""
        running = self.process.poll() is None
        members = self.members()
        for pid in members:  # none may act on the end of another
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP)
        for pid in {*members, *self.members()}:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        return running

    def strike_worker(self, rng: random.Random) -> bool:
        """Kill one worker; tell whether there was one."""
        workers = self.workers()
        if not workers:
            return False
        with contextlib.suppress(ProcessLookupError):
            os.kill(rng.choice(workers), signal.SIGKILL)
            return self.process.poll() is None
        return False

    def end(self, limit_s: float = HANGS_S) -> tuple[int, str]:
        """Wait for the end; return the exit code and what was printed."""
        try:
            said, _ = self.process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            self.strike_all()
            said, _ = self.process.communicate()
            message = f"the run hangs; it said: {said}"
            raise AssertionError(message) from None
        return self.process.returncode, said

    def ends(self, code: int) -> str:
        """Wait for the end with an exit code; return what was printed."""
        ended, said = self.end()
        assert ended == code, said
        assert "Traceback" not in said
        return said

    def wait_until_gone(self) -> float:
        """Wait until no process of the run is left; return how long that took [s]."""
        begun = time.monotonic()
        while members := self.members():
            assert time.monotonic() - begun < HANGS_S, f"still there: {members}"
            time.sleep(0.01)
        return time.monotonic() - begun


def hooked(variable: str, value: str) -> dict[str, str]:
    """Return what a run needs in its environment that ``steps/sitecustomize.py`` is to disturb."""
    path = os.pathsep.join([str(Path(__file__).parent / "steps"), os.environ.get("PYTHONPATH", "")])
    return {variable: value, "PYTHONPATH": path}


def tree(out: Path) -> dict[str, bytes]:
    """Return every file under its final name, without our own folder and the summaries."""
    content = {}
    for path in out.rglob("*"):
        name = path.relative_to(out).as_posix()
        ours = name.startswith((OWN_FOLDER, "summary."))
        if path.is_file() and not ours and path.suffix != ".part":
            content[name] = path.read_bytes()
    return content


def parts(out: Path) -> list[Path]:
    """Return all temporary files but those whose number belongs to another process by now.

    Machines are busy.
    """
    return sorted(
        path for path in out.rglob("*.part") if not is_younger(int(path.name.split("-")[-2]), path)
    )


def entries(out: Path) -> dict[str, Entry]:
    """Return what the journals know; that they open is part of every test."""
    return {entry.name: entry for entry in read_entries(out / OWN_FOLDER)}


def check_nothing_half(archive: Archive, out: Path) -> None:
    """What has its final name is whole, and the journal promises nothing that is not there."""
    files = tree(out) if out.exists() else {}
    for name, content in files.items():
        assert archive.whole.get(name) == content, f"{name!r} is not what an undisturbed run writes"
    for entry in entries(out).values() if (out / OWN_FOLDER).exists() else ():
        if entry.state == "done":
            outputs = [
                name
                for name in files
                if name.startswith(entry.name) and not name.endswith(".prc.json")
            ]
            assert len(outputs) == 1, f"{entry.name!r} is done, its output is {outputs}"


def check_known(archive: Archive, out: Path) -> None:
    """What a run left that was killed is an output, our own state, or removed by ``prc batch
    clean``."""
    if not out.exists() or not journal_paths(out / OWN_FOLDER):
        left = [
            path for path in out.rglob("*") if path.is_file() and path.parent.name != OWN_FOLDER
        ]
        assert not left, left
        return
    end = time.monotonic() + _DYING_S
    while (unknown := _unknown(archive, out)) and time.monotonic() < end:
        time.sleep(0.1)  # killed processes take a moment to die
    assert not unknown, f"prc batch clean does not know {unknown}"


_DYING_S = 10.0


def _unknown(archive: Archive, out: Path) -> list[str]:
    """Return the files that are neither outputs nor our own state, and that ``prc batch clean``
    would not remove."""
    try:
        removed = set(clean(out, dry_run=True).files)
    except BusyError as error:
        return [str(error)]
    state = re.compile(r"journal\.sqlite(-wal|-shm|-journal)?|command\.json|lock|lock\.json")
    unknown = []
    for path in out.rglob("*"):
        name = path.relative_to(out).as_posix()
        is_ours = path.parent == out / OWN_FOLDER and state.fullmatch(path.name) is not None
        is_ours = is_ours or name in archive.whole or name == "summary.json"
        is_kept = path.suffix == ".part" and path not in parts(out)
        if path.is_file() and not (is_ours or is_kept or path in removed):
            unknown.append(name)
    return unknown


def check_whole(archive: Archive, out: Path) -> None:
    """The run that resumed ended as an undisturbed one, and left nothing else."""
    assert tree(out) == archive.whole
    assert parts(out) == []
    known = entries(out)
    assert set(known) == archive.names
    assert {entry.state for entry in known.values()} == {"done"}
    known_to_clean = set(
        clean(out, dry_run=True).files
    )  # what runs on Dask asked their workers for
    files = set((out / OWN_FOLDER).rglob("*")) - known_to_clean
    left = {path.name for path in files if not path.name.endswith(("-wal", "-shm"))}
    assert left <= {"journal.sqlite", "command.json"}, left


def resume(archive: Archive, out: Path) -> None:
    """Run to the end, which is that of an undisturbed run."""
    Batch(archive, out).ends(0)
    check_whole(archive, out)


def moments(
    rng: random.Random,
    archive: Archive,
    out: Path,
    batch: Batch,
) -> Iterator[str]:
    """Wait for a random moment and yield what it is.

    Some time after the start, or just when a file appears.
    """
    if rng.random() < 0.5:
        with contextlib.suppress(subprocess.TimeoutExpired):
            batch.process.wait(rng.uniform(0.0, archive.seconds))
        yield "time"
        return
    wanted = rng.choice([".part", "", ".json"])
    known = set(out.rglob("*")) if out.exists() else set()
    end = time.monotonic() + 2 * archive.seconds
    n_more = rng.randrange(3)
    while time.monotonic() < end and batch.process.poll() is None:
        new = (
            {path for path in out.rglob("*") if OWN_FOLDER not in path.parts} - known
            if out.exists()
            else set()
        )
        if any(path.suffix == wanted or not wanted for path in new):
            if not n_more:
                break
            n_more -= 1
        known |= new
        time.sleep(0.001)
    time.sleep(rng.random() * 0.02)
    yield "file"


def fresh(folder: Path) -> Path:
    """Return a folder that does not exist."""
    shutil.rmtree(folder, ignore_errors=True)
    return folder


@dataclass
class Tally:
    """What a series of kills met."""

    kills: dict[str, int] = field(default_factory=dict)
    """Processes killed while they ran, by what was killed."""
    runs: int = 0
    came_too_late: int = 0
    """Runs that had ended."""
    with_parts: int = 0
    """Kills that left temporary files: in the middle of writing."""
    with_running: int = 0
    """Kills that left files which the journal calls running."""
    resumed_to_the_end: int = 0
    longest_orphan_s: float = 0.0

    def count(self, kind: str) -> None:
        self.kills[kind] = self.kills.get(kind, 0) + 1
