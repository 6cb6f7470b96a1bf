"""Damaged files of every format through every command, in a watched worker.

More examples: ``HYPOTHESIS_EXAMPLES=600 python -m pytest -m slow tests/fuzz/test_hostile.py``.
"""

from __future__ import annotations

import io
import os
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from prc_cli.core.errors import PrcError
from prc_cli.formats.arrays.rows import ArrayFile
from prc_cli.formats.input import Input
from prc_cli.formats.labels import open_codes
from prc_cli.formats.options import InputConfig
from prc_cli.formats.registry import by_suffix
from tests import patience
from tests.fuzz.damage import damaged
from tests.fuzz.guard import unprintable
from tests.fuzz.kept import KeptFile, attempt, kept_files
from tests.fuzz.seeds import RECORDINGS, SEEDS, seed, write_seeds
from tests.fuzz.targets import TARGETS, lay, sound_of, suffix_of_seed
from tests.fuzz.watched import WatchedWorker

pytestmark = pytest.mark.slow

EXAMPLES = int(os.environ.get("HYPOTHESIS_EXAMPLES", "6"))
"""Damaged files for each target."""


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[WatchedWorker, Path]]:
    pytest.importorskip("resource", reason="workers are limited by what only POSIX has")
    folder = tmp_path_factory.mktemp("fuzz")
    (folder / "seeds").mkdir()
    write_seeds(folder / "seeds")
    watched = WatchedWorker(folder)
    yield watched, folder
    watched.close()


@pytest.mark.parametrize("name", TARGETS)
@settings(
    max_examples=EXAMPLES,
    suppress_health_check=list(HealthCheck),
)
@given(data=st.data())
def test_damaged_files_are_refused_or_read(
    worker: tuple[WatchedWorker, Path], name: str, data: st.DataObject
) -> None:
    watched, folder = worker
    target = TARGETS[name]
    chosen = data.draw(st.sampled_from(target.seeds))
    command = data.draw(st.sampled_from(target.commands))
    content = data.draw(damaged(seed(chosen), suffix_of_seed(chosen)))
    case = lay(folder, target, chosen, content)
    answer = watched.run(command, case, str(sound_of(folder / "seeds", target, chosen)))
    assert not answer["faults"]


@pytest.mark.parametrize("name", TARGETS)
def test_the_first_command_takes_the_seed(worker: tuple[WatchedWorker, Path], name: str) -> None:
    """Else every case would be refused for a reason that is not its damage."""
    from tests.fuzz.worker import DONE  # of POSIX alone, as the worker

    watched, folder = worker
    chosen = TARGETS[name].seeds[0]
    case = lay(folder, TARGETS[name], chosen, seed(chosen), "sound")
    sound = str(sound_of(folder / "seeds", TARGETS[name], chosen))
    answers = [watched.run(command, case, sound) for command in TARGETS[name].commands[:6]]
    assert answers[0]["code"] in DONE, (TARGETS[name].commands[0], answers[0]["said"])
    assert not [answer["faults"] for answer in answers if answer["faults"]]


@pytest.mark.parametrize("kept", [pytest.param(kept, id=kept.stem) for kept in kept_files()])
def test_a_file_that_showed_a_fault_is_refused_or_read(
    worker: tuple[WatchedWorker, Path], kept: KeptFile
) -> None:
    watched, folder = worker
    answer = attempt(watched, folder, kept)
    assert not answer["faults"]
    assert kept.code is None or answer["code"] == kept.code


ATTACKS = (
    "import os; os.system('true')",
    "exec('1')",
    "eval('1+1')",
    "import socket; socket.socket()",
    "import subprocess; subprocess.run(['true'])",
    "import pickle; pickle.loads(EVIL)",
    "open('/tmp/prc-fuzz-outside', 'w')",
    "import os; os.remove('/tmp/prc-fuzz-not-there')",
)


@pytest.mark.parametrize("text", ATTACKS)
def test_the_guard_sees(tmp_path: Path, text: str) -> None:
    """In a process of its own: a hook can never be removed."""
    import sys

    program = (
        "import sys, pathlib\nfrom tests.fuzz.guard import Guard\n"
        "import os, socket, subprocess, pickle, collections\nEVIL = "
        "pickle.dumps(collections.Counter)\n"
        f"guard = Guard((pathlib.Path({str(tmp_path)!r}),))\n"
        "def attack():\n    try:\n        " + text + "\n    except OSError:\n        pass\n"
        "with guard.armed() as seen:\n    open(guard._folders[0] + 'inside', 'w').close()\n"
        "    quiet = list(seen)\n    attack()\n"
        "pathlib.Path('/tmp/prc-fuzz-outside').unlink(missing_ok=True)\nsys.exit(0 if seen "
        "and not quiet else 1)\n"
    )
    script = tmp_path / "attack.py"
    script.write_text(program)
    root = Path(__file__).resolve().parents[2]
    assert (
        patience.run([sys.executable, str(script)], env={"PYTHONPATH": str(root)}).returncode == 0
    )


class Evil:
    """Writes a file when it is loaded from a pickle."""

    def __init__(self, target: str) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return Path.touch, (Path(self.target),)  # type: ignore[return-value]


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_a_pickle_is_never_loaded(tmp_path: Path, suffix: str) -> None:
    victim = tmp_path / "victim"
    array = np.array([[Evil(str(victim))] * 24] * 14, dtype=object)
    path = tmp_path / f"a{suffix}"
    np.save(path, array) if suffix == ".npy" else np.savez(path, range_m=array)
    for read in (
        lambda: open_codes(path),
        lambda: next(iter(ArrayFile(path).headers.values())).check_numbers(),
    ):
        with pytest.raises(PrcError, match="Python objects"):
            read()
    assert not victim.exists()
    np.load(path, allow_pickle=True)[...] if suffix == ".npy" else np.load(path, allow_pickle=True)[
        "range_m"
    ]
    assert victim.exists(), "the attack itself is not one"


def test_names_inside_an_archive_are_no_paths(tmp_path: Path) -> None:
    out = io.BytesIO()
    array = io.BytesIO()
    np.save(array, np.ones((14, 24), np.float32))
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("../../range_m.npy", array.getvalue())
    inside = tmp_path / "a" / "b"
    inside.mkdir(parents=True)
    (inside / "a.npz").write_bytes(out.getvalue())
    with ArrayFile(inside / "a.npz").open("../../range_m") as (rows,):
        assert rows.read(14).shape == (14, 24)
    assert [path.name for path in tmp_path.rglob("*.npy")] == []


@pytest.mark.parametrize(
    "name", [name for name in SEEDS if f".{name.split('.', 1)[1]}" in by_suffix("codes")]
)
def test_every_cut_is_refused_or_read(tmp_path: Path, name: str) -> None:
    """At every power of two, around every structure of a LAS file, and one byte early."""
    data = seed(name)
    edges = {
        len(data) - 1,
        *(1 << k for k in range(16)),
        227,
        235,
        375,
        *(struct.unpack_from("<HI", data, 94) if name[-4:] in (".las", ".laz") else ()),
    }
    path = tmp_path / f"a{suffix_of_seed(name)}"
    refused = []
    for edge in sorted(edge for edge in edges if 0 < edge < len(data)):
        path.write_bytes(data[:edge])
        try:
            source = (
                Input.of(path).records()
                if path.suffix != ".label" and path.suffix != ".parquet"
                else None
            )
            for chunk in source.chunks(source.dimensions) if source is not None else ():
                assert chunk.n
            for codes in open_codes(path).codes():
                assert codes.dtype == np.int64
        except PrcError as error:
            refused.append(error.where)
    assert all(where.startswith(str(path)) for where in refused), refused


@pytest.mark.parametrize("name", RECORDINGS)
def test_every_cut_recording_is_refused_or_read(tmp_path: Path, name: str) -> None:
    """Up to the cut, and it says so, or it is refused."""
    data = seed(name)
    path = tmp_path / f"a{suffix_of_seed(name)}"
    lengths = []
    errors = []
    (tmp_path / "a.json").write_bytes(seed("ouster.json"))
    for edge in (*range(len(data) // 9, len(data), len(data) // 9), len(data) - 1, len(data)):
        path.write_bytes(data[:edge])
        try:
            stream = Input.of(path).images(InputConfig())
            n_lines = sum(block.n_lines for block in stream.blocks())
            lengths.append(
                (n_lines, any("read up to there" in note for note in stream.info.facts.notes))
            )
        except PrcError as error:
            errors.append(error.where)
    whole = lengths[-1][0]
    assert all(where.startswith(str(path)) for where in errors)
    assert lengths == sorted(lengths, key=lambda pair: pair[0])
    assert all(is_told for n_lines, is_told in lengths if n_lines < whole)
    # bags without their index are refused
    assert name.endswith(("bag", "mcap", "db3")) or len(lengths) > 3


@given(st.text())
def test_what_is_unprintable(text: str) -> None:
    from prc_cli.core.errors import printable, printable_lines

    assert not unprintable(printable(text))
    assert not unprintable(printable_lines(text))
    assert "\n" not in printable(text)


REAL = ("profiler/jakarto_0.02s.las", "las/plane.laz", "las/fullwave_pf10.laz")


@pytest.mark.data
@pytest.mark.parametrize("name", [*REAL, "las/mls_not_in_time_order.las"])
@settings(max_examples=5, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_real_scans_damaged(
    worker: tuple[WatchedWorker, Path], real_data: Path, name: str, data: st.DataObject
) -> None:
    watched, folder = worker
    suffix = Path(name).suffix
    case = folder / f"real{suffix}"
    case.write_bytes(data.draw(damaged((real_data / name).read_bytes(), suffix)))
    answer = watched.run(data.draw(st.sampled_from(TARGETS[suffix[1:]].commands)), case)
    assert not answer["faults"]


def test_other_things_than_files_are_refused(tmp_path: Path) -> None:
    for name in ("/dev/zero", str(tmp_path)):
        link = tmp_path / "a.las"
        link.unlink(missing_ok=True)
        link.symlink_to(name)
        with pytest.raises(PrcError, match="not a regular file|is a folder"):
            Input.of(link).check()
