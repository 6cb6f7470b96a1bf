"""Damaged files of every format through every command, in watched processes.

More examples: ``HYPOTHESIS_EXAMPLES=600 python -m pytest -m slow tests/fuzz/test_hostile.py``.
"""

import io
import os
import struct
import sys
import zipfile
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
from tests.fuzz.crafted import KEPT
from tests.fuzz.damage import damaged
from tests.fuzz.guard import unprintable
from tests.fuzz.seeds import RECORDINGS, SEEDS, seed, write_seeds
from tests.fuzz.targets import DRAWN, TARGETS, URBAN, lay, suffix_of_seed

pytest.importorskip("resource", reason="commands are limited by what only POSIX has")

from tests.fuzz.server import DONE, Server

pytestmark = pytest.mark.slow

EXAMPLES = int(os.environ.get("HYPOTHESIS_EXAMPLES", "4"))
"""Damaged files for each target."""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    write_seeds(folder / "seeds")
    server = Server(folder)
    yield server, folder
    server.close()


@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_files_are_refused_or_read(server, name, data):
    target = TARGETS[name]
    chosen = data.draw(st.sampled_from(target.names))
    command = data.draw(st.sampled_from(target.commands))
    content = data.draw(damaged(seed(chosen), suffix_of_seed(chosen)))
    case = lay(server[1], target, chosen, content)
    assert not server[0].run(command, case)["faults"]


@pytest.mark.parametrize("name", TARGETS)
def test_the_first_command_takes_the_seed(server, name):
    """Else every case would be refused for a reason that is not its damage."""
    target = TARGETS[name]
    case = lay(server[1], target, target.names[0], seed(target.names[0]))
    answer = server[0].run(target.commands[0], case)
    assert answer["code"] in DONE, answer["printed"]
    assert not answer["faults"]


@pytest.mark.parametrize(
    "name, command, code",
    [
        ("endless.db3", "info {case} --deep", 0),
        ("huge_page.parquet", "evaluate {case} {case} --dimension range", 1),
        ("wide.las", f"classify {{case}} {{out}}/o.las {URBAN} --set output.segment_ids=true", 0),
        ("overflow.npy", f"render {{case}} {{out}}/o.png {DRAWN}", 0),
        ("overflow.ply", "convert {case} {out}/o.npz --trust-order", 4),
        (
            "cast.ply",
            "convert {case} {out}/o.npz --trust-order -M 24 --lines fixed --columns order "
            "--range origin:0,0,2 --set input.partial_line=pad",
            4,
        ),
        ("cast.bin", f"classify {{case}} {{out}}/o.npy {URBAN}", 1),
        ("overflowing.laz", "convert {case} {out}/o.las", None),
    ],
)
def test_a_file_that_showed_a_fault_is_refused_or_read(server, name, command, code):
    answer = server[0].run(command, KEPT / name)
    assert not answer["faults"]
    assert code is None or answer["code"] == code, answer["printed"]


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
def test_the_guard_sees(tmp_path, text):
    """In a process of its own: a hook can never be removed."""
    program = f"""
import os, socket, subprocess, pickle, collections, sys
from pathlib import Path
from tests.fuzz.guard import watch
EVIL = pickle.dumps(collections.Counter)
folder = Path({str(tmp_path)!r})
seen = watch((folder,))
(folder / "inside").touch()
quiet = list(seen)
try:
    {text}
except OSError:
    pass
sys.exit(0 if seen and not quiet else 1)
"""
    root = Path(__file__).resolve().parents[2]
    environment = {"PYTHONPATH": str(root)}
    assert patience.run([sys.executable, "-c", program], env=environment).returncode == 0
    Path("/tmp/prc-fuzz-outside").unlink(missing_ok=True)


class Evil:
    """Writes a file when it is loaded from a pickle."""

    def __init__(self, target: str) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return Path.touch, (Path(self.target),)  # type: ignore[return-value]


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_a_pickle_is_never_loaded(tmp_path, suffix):
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


def test_names_inside_an_archive_are_no_paths(tmp_path):
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
def test_every_cut_is_refused_or_read(tmp_path, name):
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
            if path.suffix not in (".label", ".parquet"):
                source = Input.of(path).records()
                for chunk in source.chunks(source.dimensions) if source is not None else ():
                    assert chunk.n
            for codes in open_codes(path).codes():
                assert codes.dtype == np.int64
        except PrcError as error:
            refused.append(error.where)
    assert all(where.startswith(str(path)) for where in refused), refused


@pytest.mark.parametrize("name", RECORDINGS)
def test_every_cut_recording_is_refused_or_read(tmp_path, name):
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
def test_what_is_unprintable(text):
    from prc_cli.core.errors import printable, printable_lines

    assert not unprintable(printable(text))
    assert not unprintable(printable_lines(text))
    assert "\n" not in printable(text)


def test_other_things_than_files_are_refused(tmp_path):
    for name in ("/dev/zero", str(tmp_path)):
        link = tmp_path / "a.las"
        link.unlink(missing_ok=True)
        link.symlink_to(name)
        with pytest.raises(PrcError, match="not a regular file|is a folder"):
            Input.of(link).check()
