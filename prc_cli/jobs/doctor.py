"""Checks of an installation and of a folder for outputs: ``prc doctor``.

The checks remove the files that they write. Each check imports its own packages, so a broken
package makes only that check fail.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata as metadata
import os
import platform
import re
import shutil
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, get_args

from prc_cli.core.errors import PrcError
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.core.profile import peak_memory
from prc_cli.core.threads import default_threads
from prc_cli.core.version import __version__

if TYPE_CHECKING:
    from prc_cli.core.loops import Loops
    from prc_cli.simulation.settings import Kind

Status: TypeAlias = Literal["ok", "warn", "bad"]

DISTRIBUTION = "prc-cli"
DEVELOPERS = ("test", "docs")
"""Extras for development only."""
MODULES = {"pillow": "PIL", "scikit-image": "skimage"}
"""Modules of packages that are imported by another name."""
VECTORS = ("avx512f", "avx2", "avx", "sse4.2", "sve", "neon")
"""Vector extensions that speed up loops, the best first."""
MEMORY_BYTES = 1 << 30
"""Free memory above which one file per core is always possible."""
DISK_BYTES = 2 << 30
"""Free disk space below which a warning is given."""
CACHE_BYTES = 300 << 20
"""Space for the cache of compiled code, including the next version."""
CLOCK_S = 5.0
"""Clock difference between a file server and this machine above which a warning is given [s]."""
LINES = 200
"""Scan lines of the end-to-end run."""
LEAST_SCORE = 0.9
"""Limit of the recall of ground and the precision of building in that run (0.99 and 0.97)."""
COMPARED: Mapping[str, tuple[Kind, Mapping[str, Any]]] = {
    "prc-2019-urban": ("street", {"seed": 1, "lines": 120, "scanner": {"points_per_line": 250}}),
    "prc-2019-forest": (
        "forest",
        {"seed": 2, "lines": 120, "sight_m": 20.0, "scanner": {"points_per_line": 400}},
    ),
    "street-scan": (
        "street-scan",
        {
            "seed": 3,
            "scanner": {"azimuth_step_deg": 4, "points_per_line": 80},
            "station": {"turn_deg": 70},
        },
    ),
}
"""Presets that both engines run, and their scans: small ones with most classes."""
_NETWORK = (
    "nfs",
    "cifs",
    "smb",
    "fuse",
    "9p",
    "lustre",
    "gpfs",
    "beegfs",
    "ceph",
    "afs",
    "glusterfs",
    "virtiofs",
)
"""File systems that several machines may share."""


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check."""

    name: str
    status: Status
    text: str
    """Result, in a sentence."""
    hint: str = ""
    """What to do; empty if the check is ok."""
    details: Mapping[str, Any] = field(default_factory=dict)
    """The result as plain values."""


class Fault(NamedTuple):
    """A possible fault of a check."""

    applies: object
    """Whether the fault is there, as a truth value."""
    status: Status
    more: str
    """What it adds to the text of the check."""
    hint: str


def _check(name: str, text: str, details: Mapping[str, Any], *faults: Fault) -> Check:
    """Return the check with its first fault that applies; without any it is ok."""
    for fault in faults:
        if fault.applies:
            return Check(name, fault.status, text + fault.more, fault.hint, details)
    return Check(name, "ok", text, "", details)


def examine(out: Path | None = None, *, run: bool = True) -> Iterator[Check]:
    """Run all checks, one after the other."""
    checks: list[tuple[str, Callable[[], Iterator[Check]]]] = [
        ("python", _python),
        ("packages", _packages),
        ("extras", _extras),
        ("LAZ", _laz),
        ("processor", _processor),
        ("compiled loops", _cache),
        ("memory", _memory),
        ("temporary files", _temporary),
    ]
    if out is not None:
        checks.append(("output folder", lambda: _output(out)))
    if run:
        checks += [("end to end", _end_to_end), ("engines", _engines)]
    for name, check in checks:
        try:
            yield from check()
        except Exception as error:  # finding what is broken is the purpose
            yield _broken(name, error)


def _broken(name: str, error: Exception) -> Check:
    if isinstance(error, PrcError):
        return Check(name, "bad", str(PrcError(error.where, error.problem)), error.hint)
    if isinstance(error, OSError | sqlite3.Error):
        return Check(
            name, "bad", str(error), "check the disk: its space, its permissions, its mount"
        )
    if isinstance(error, ImportError):
        hint = "install this package again: pip install --force-reinstall PACKAGE"
        return Check(name, "bad", f"cannot be loaded ({error})", hint)
    return Check(
        name,
        "bad",
        f"{type(error).__name__}: {error}",
        "report it with the output of prc doctor --json",
    )


def _python() -> Iterator[Check]:
    version = platform.python_version()
    encoding = sys.getfilesystemencoding()
    details = {
        "version": version,
        "executable": sys.executable,
        "platform": platform.platform(),
        "prc": __version__,
    }
    needed = ""
    with contextlib.suppress(metadata.PackageNotFoundError):
        needed = ", ".join(metadata.metadata(DISTRIBUTION).get_all("Requires-Python") or [])
    yield _check(
        "python",
        f"prc {__version__}, Python {version} on {platform.system()} {platform.machine()}",
        details,
        Fault(
            not _is_met(version, needed),
            "bad",
            f", expected Python {needed}",
            "install a newer Python",
        ),
        Fault(
            encoding.lower() != "utf-8",
            "warn",
            f"; file names are encoded as {encoding}",
            "set PYTHONUTF8=1, so that names are printed correctly",
        ),
    )


def _is_met(version: str, needed: str) -> bool:
    """Compare a version with a bound; a release candidate counts as its release."""
    from packaging.specifiers import SpecifierSet
    from packaging.version import Version

    return bool(version) and SpecifierSet(needed).contains(Version(version).base_version)


class _Requirement(NamedTuple):
    name: str
    at_least: str
    extra: str
    installed: str
    """Installed version, empty if none."""

    @property
    def is_met(self) -> bool:
        return _is_met(self.installed, f">={self.at_least}")

    def __str__(self) -> str:
        return f"{self.name} {self.installed or 'missing'} (expected {self.at_least} or newer)"


def _requirements() -> list[_Requirement]:
    from packaging.requirements import Requirement

    requirements = []
    with contextlib.suppress(metadata.PackageNotFoundError):
        for text in metadata.requires(DISTRIBUTION) or []:
            requirement = Requirement(text)
            version = ""
            extra = re.search(r"extra == \"([^\"]+)", str(requirement.marker or ""))
            with contextlib.suppress(metadata.PackageNotFoundError):
                version = metadata.version(requirement.name)
            at_least = str(requirement.specifier).removeprefix(">=")
            requirements.append(
                _Requirement(requirement.name, at_least, extra[1] if extra else "", version)
            )
    return sorted(requirements, key=lambda item: item.extra)


def _packages() -> Iterator[Check]:
    """Compare installed versions with the bounds in the metadata, and import the packages."""
    required = [item for item in _requirements() if not item.extra]
    old = [item for item in required if not item.is_met]
    broken = {} if old else _broken_packages([item.name for item in required])
    details = {item.name: {"found": item.installed, "at_least": item.at_least} for item in required}
    if not required:
        hint = "install prc, so that its dependencies are known: pip install prc-cli"
        yield Check(
            "packages",
            "warn",
            f"{DISTRIBUTION} is not installed: prc runs from a source tree",
            hint,
        )
    elif old:
        wanted = " ".join(f"'{item.name}>={item.at_least}'" for item in old)
        yield Check("packages", "bad", ", ".join(map(str, old)), f"pip install {wanted}", details)
    elif broken:
        failures = ", ".join(f"{name} cannot be loaded ({why})" for name, why in broken.items())
        yield Check(
            "packages",
            "bad",
            failures,
            f"pip install --force-reinstall {' '.join(broken)}",
            details,
        )
    else:
        yield Check(
            "packages",
            "ok",
            ", ".join(f"{item.name} {item.installed}" for item in required),
            "",
            details,
        )


def _broken_packages(names: Iterable[str]) -> dict[str, str]:
    """Import packages; return those that fail to import, and why."""
    broken = {}
    for name in names:
        try:
            importlib.import_module(MODULES.get(name, name))
        except Exception as error:  # an import may raise anything
            broken[name] = f"{type(error).__name__}: {error}"
    return broken


def _extras() -> Iterator[Check]:
    """Report which optional parts are installed."""
    installed = []
    missing = []
    details = {}
    old = []
    for extra, group in groupby(_requirements(), key=lambda item: item.extra):
        if not extra or extra in DEVELOPERS:
            continue
        items = list(group)
        details[extra] = {item.name: item.installed for item in items}
        old += [item for item in items if item.installed and not item.is_met]
        if all(item.installed for item in items):
            installed.append(extra)
        else:
            missing.append(extra)
    text = f"installed: {', '.join(installed) or 'none'}"
    if missing:
        text += f'; not installed: {", ".join(missing)} (pip install ".[NAME]")'
    if installed or missing:
        yield _check(
            "extras",
            text,
            details,
            Fault(
                old,
                "warn",
                f"; {', '.join(map(str, old))}",
                f"pip install -U {' '.join(item.name for item in old)}",
            ),
        )


def _laz() -> Iterator[Check]:
    from prc_cli.formats.las.laz import check_laz

    formats = check_laz()
    version = metadata.version("lazrs")
    yield Check(
        "LAZ", "ok", f"lazrs {version} writes and reads records of formats {formats} correctly"
    )


def _processor() -> Iterator[Check]:
    from prc_cli.core.compiling import is_compiling_off
    from prc_cli.core.loops import load_compiler

    load_compiler()
    import llvmlite.binding  # type: ignore[import-untyped]

    name = llvmlite.binding.get_host_cpu_name()
    has = llvmlite.binding.get_host_cpu_features()
    vectors = [feature for feature in VECTORS if has.get(feature)]
    usable = default_threads()
    all_cores = os.cpu_count() or 1
    features = ", ".join(vectors) or "no vector instructions"
    cores = f"{usable} of {all_cores} cores" if usable < all_cores else f"{usable} cores"
    details = {
        "cores": usable,
        "of": all_cores,
        "processor": name,
        "features": vectors,
    }
    load = 0.0
    with contextlib.suppress(OSError, AttributeError):  # not on this system
        load = os.getloadavg()[0]
    yield _check(
        "processor",
        f"{cores}, {name} ({features})",
        details,
        Fault(
            is_compiling_off(),
            "bad",
            "; compiling is turned off",
            "unset NUMBA_DISABLE_JIT: without compiling prc is a hundred times slower",
        ),
        Fault(
            load > 2 * all_cores,
            "warn",
            f"; {load:.0f} processes are running or waiting",
            "wait, or use fewer --jobs",
        ),
    )


def every_loop() -> Loops:
    """Return the compiled loops of this package."""
    from prc_cli.core.loops import loops_of

    root = Path(__file__).parents[1]
    files = sorted(file.relative_to(root.parent) for file in root.rglob("*_loops.py"))
    return loops_of(
        *(importlib.import_module(".".join(file.with_suffix("").parts)) for file in files)
    )


def _cache() -> Iterator[Check]:
    from prc_cli.core.loop_cache import writable_cache
    from prc_cli.core.loops import load_compiler

    load_compiler()
    folder = writable_cache()
    loops = every_loop()
    modules = {loop.module for loop in loops}
    n_compiled = len(modules - {loop.module for loop in loops if not loop.is_compiled()})
    n_bytes = 0
    for path in folder.rglob("*") if folder is not None else ():
        with contextlib.suppress(OSError):  # another process may remove it
            n_bytes += path.stat().st_size
    temporary = Path(tempfile.gettempdir()).resolve()
    details = {
        "folder": None if folder is None else str(folder),
        "bytes": n_bytes,
        "compiled": n_compiled,
        "modules": len(modules),
    }
    if folder is None:
        hint = "set NUMBA_CACHE_DIR to a writable folder, else every run compiles for half a minute"
        yield Check("compiled loops", "warn", "there is no writable folder for them", hint, details)
        return
    free = shutil.disk_usage(folder).free
    is_lost = not os.environ.get("NUMBA_CACHE_DIR") and folder.resolve().is_relative_to(temporary)
    text = f"{n_compiled} of {len(modules)} modules compiled, {_size(n_bytes)} in {folder}"
    yield _check(
        "compiled loops",
        text,
        details,
        Fault(
            free < CACHE_BYTES,
            "warn",
            f", {_size(free)} free",
            "delete files, or set NUMBA_CACHE_DIR to a folder on another disk",
        ),
        Fault(
            is_lost,
            "warn",
            "",
            "set NUMBA_CACHE_DIR to another folder: the system empties temporary folders",
        ),
    )


def _memory() -> Iterator[Check]:
    free = _free_memory()
    cores = default_threads()
    if free is None:
        return
    yield _check(
        "memory",
        f"{_size(free)} free for {cores} cores",
        {"free_bytes": free},
        Fault(
            free < MEMORY_BYTES,
            "bad",
            "",
            "close other programs, or give the container more memory",
        ),
        Fault(
            free < cores * MEMORY_BYTES,
            "warn",
            "",
            f"use at most --jobs {max(1, free // MEMORY_BYTES)}",
        ),
    )


def _free_memory() -> int | None:
    """Available memory of the machine and its container (cgroups version 2 and 1) [bytes]."""
    free_bytes = []
    with contextlib.suppress(OSError, ValueError, IndexError):
        text = Path("/proc/meminfo").read_text(encoding="ascii")
        free_bytes.append(int(text.partition("MemAvailable:")[2].split()[0]) << 10)
    groups = Path("/sys/fs/cgroup")
    for limit, used in (
        ("memory.max", "memory.current"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),
    ):
        with contextlib.suppress(OSError, ValueError):
            free_bytes.append(int((groups / limit).read_text()) - int((groups / used).read_text()))
    return max(0, min(free_bytes)) if free_bytes else None


def _temporary() -> Iterator[Check]:
    folder = Path(tempfile.gettempdir())
    wanted = os.environ.get("TMPDIR")
    free = shutil.disk_usage(folder).free
    with tempfile.TemporaryFile(dir=folder) as handle:
        handle.write(b"x")
    yield _check(
        "temporary files",
        f"{_size(free)} free in {folder}",
        {"folder": str(folder), "free_bytes": free},
        Fault(
            wanted and Path(wanted) != folder,
            "warn",
            f"; TMPDIR={wanted} cannot be used",
            f"create the folder: mkdir -p {wanted}, or set TMPDIR to another",
        ),
        Fault(
            free < DISK_BYTES,
            "warn",
            "",
            "set TMPDIR to a folder on a larger disk: --sort-by-time and --match need space",
        ),
    )


def _output(out: Path) -> Iterator[Check]:
    """Check a folder for the needs of a batch run."""
    from prc_cli.jobs.batch.types import OWN_FOLDER

    folder = out
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    name = f"output folder {out}"
    if not folder.is_dir():
        yield Check(name, "bad", f"{folder} is not a folder", "choose another output folder")
        return
    try:
        trial = Path(tempfile.mkdtemp(prefix=".prc-doctor-", dir=folder))
    except OSError as error:
        problem = f"cannot be written ({error.strerror or error})"
        yield Check(name, "bad", problem, "change its permissions, or choose another folder")
        return
    try:
        free = shutil.disk_usage(folder).free
        kind = file_system(folder)
        is_new = "" if folder == out else f" ({folder}; prc creates the folder)"
        yield _check(
            "output disk",
            f"{_size(free)} free on {kind or 'an unknown file system'}{is_new}",
            {"folder": str(folder), "free_bytes": free, "file_system": kind},
            Fault(
                free < DISK_BYTES,
                "warn",
                "",
                "delete files: docs, Operations, lists the disk space of a run",
            ),
        )
        yield _locks(trial)
        yield _sqlite(trial)
    finally:
        shutil.rmtree(trial, ignore_errors=True)
    if (out / OWN_FOLDER).is_dir():
        yield _runs(out / OWN_FOLDER)


def _runs(folder: Path) -> Check:
    """Check the journal of earlier runs; raises if it is damaged."""
    from prc_cli.jobs.batch.journal import read_entries
    from prc_cli.jobs.batch.lock import holders

    entries = read_entries(folder)
    at_work = [str(item.owner) for item in holders(folder) if item.alive]
    states = Counter(entry.state for entry in entries)
    versions = sorted({entry.version for entry in entries})
    text = ", ".join(f"{count:,} {state}" for state, count in sorted(states.items())) or "no files"
    details = {"files": dict(states), "versions": versions, "at_work": at_work}
    hint = "prc batch classifies their files again"
    older = set(versions) - {__version__}
    return _check(
        "earlier runs",
        text,
        details,
        Fault(at_work, "ok", f"; running now: {', '.join(at_work[:1])}", ""),
        Fault(older, "warn", f"; some by version {', '.join(versions)}", hint),
    )


def _locks(trial: Path) -> Check:
    """Try the lock of a batch run, and compare the clock of the file server."""
    from prc_cli.jobs.batch.lock import has_locks

    before = time.time()
    (trial / "file").write_bytes(b"x")
    clock_s = (trial / "file").stat().st_mtime - before
    locks = has_locks(trial)
    return _check(
        "locks in it",
        "",
        {"locks": locks, "clock_s": round(clock_s, 3)},
        Fault(
            not locks,
            "bad",
            "the file system has no file locks",
            "choose another disk for prc batch; for Lustre: mount it with -o flock",
        ),
        Fault(
            abs(clock_s) > CLOCK_S,
            "warn",
            f"locks work; the clock of the file server is {clock_s:+.0f} s off",
            "synchronise both clocks with NTP: prc batch compares times of files",
        ),
        Fault(True, "ok", "locks work", ""),
    )


def _sqlite(trial: Path) -> Check:
    """Write as the journal does, while a second connection reads."""
    path = trial / "journal.sqlite"
    kind = file_system(trial)
    with contextlib.closing(sqlite3.connect(path, timeout=2.0, isolation_level=None)) as writer:
        writer.execute("PRAGMA synchronous=EXTRA")
        writer.execute("CREATE TABLE trial (n INTEGER)")
        writer.execute("BEGIN IMMEDIATE")
        writer.execute("INSERT INTO trial VALUES (1)")
        writer.execute("COMMIT")
        with contextlib.closing(sqlite3.connect(path, timeout=2.0)) as reader:
            n = reader.execute("SELECT count(*) FROM trial").fetchone()[0]
    return _check(
        "journal in it",
        f"SQLite {sqlite3.sqlite_version}",
        {"sqlite": sqlite3.sqlite_version, "file_system": kind},
        Fault(n != 1, "bad", ": the journal cannot be read back", "use another disk for outputs"),
        Fault(
            kind.startswith(_NETWORK),
            "warn",
            f" on {kind}, a network file system",
            "if several machines write there, use --shard i/n: each has its own journal",
        ),
    )


def file_system(folder: Path, mounts: Path = Path("/proc/self/mounts")) -> str:
    """Return the type of a folder's file system; empty if the system does not report it."""
    place = folder.resolve()
    kind = ""
    longest = -1
    lines = list[str]()
    with contextlib.suppress(OSError):
        lines = mounts.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    for line in lines:
        fields = line.split(" ")
        if len(fields) < 3:
            continue
        # blanks in names are octal escapes there; the last mount of a folder hides earlier ones
        point = Path(re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), fields[1]))
        if len(point.parts) >= longest and place.is_relative_to(point):
            longest = len(point.parts)
            kind = fields[2]
    return kind


def _end_to_end() -> Iterator[Check]:
    """Simulate a street, classify it from LAZ to LAZ, evaluate it, and read it with laspy."""
    from prc_cli.config import load_config
    from prc_cli.evaluation.scores import gate_value, scores
    from prc_cli.formats.las.read import classes_by_laspy
    from prc_cli.jobs.classify import classify, load_classifier
    from prc_cli.jobs.evaluate import evaluate
    from prc_cli.jobs.simulate import simulate
    from prc_cli.simulation.drive import load_simulator
    from prc_cli.simulation.settings import load_settings

    start = time.perf_counter()
    config = load_config(preset="prc-2019-urban", options={"input": {"order": "trust"}})
    load_simulator()
    load_classifier(config)
    loaded = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="prc-doctor-") as name:
        scan = Path(name, "street.laz")
        output = Path(name, "classified.laz")
        options = {"lines": LINES, "seed": 1, "scanner": {"points_per_line": 1000}}
        simulate("street", scan, load_settings("street", options=options))
        summary = classify(scan, output, config)
        all_scores = scores(evaluate(output, scan))
        by_laspy = classes_by_laspy(output)
        values = {
            name: gate_value(all_scores, name) for name in ("recall.ground", "precision.building")
        }
    seconds = time.perf_counter() - loaded
    n_shots = summary.counts.n_shots
    written = {item.code: item.count for item in summary.record.classes}
    details = {
        "shots": n_shots,
        "seconds": round(seconds, 3),
        "loading_s": round(loaded - start, 3),
        "scores": {name: round(value, 4) for name, value in values.items()},
        "peak_memory_bytes": peak_memory(),
    }
    shown = ", ".join(f"{name} {value:.2f}" for name, value in values.items())
    text = (
        f"simulated, classified and evaluated a street of {n_shots:,} shots in {seconds:.1f} s "
        f"({shown}); loading took {loaded - start:.1f} s"
    )
    yield _check(
        "end to end",
        text,
        details,
        Fault(
            not min(values.values()) >= LEAST_SCORE,
            "bad",
            f"; expected at least {LEAST_SCORE} of both",
            "the compiled loops are wrong on this machine: delete the cache folder above, "
            "and report it",
        ),
        Fault(
            by_laspy != written,
            "bad",
            "; laspy reads other classes than prc wrote",
            "report it, with the versions above",
        ),
        Fault(True, "ok", "; laspy reads the same classes", ""),
    )


def _engines() -> Iterator[Check]:
    """Classify small simulated scans with both engines."""
    from prc_cli.config import load_config
    from prc_cli.core.blocks import join
    from prc_cli.core.loops import Engine
    from prc_cli.jobs.classify import classify_ranges, load_classifier
    from prc_cli.simulation.settings import load_settings, open_simulation

    n_shots = 0
    n_other = {}
    seconds = 0.0
    for preset, (kind, options) in COMPARED.items():
        # labels are compared, not believed: the scans are coarse, and mostly noise with some
        # presets
        config = load_config(preset=preset, options={"input": {"accept_doubts": CHECK_NAMES}})
        load_classifier(config)
        start = time.perf_counter()
        simulation = open_simulation(kind, load_settings(kind, options=options), threads=1)
        block = join(list(simulation.scan.blocks()))
        labels = {}
        for engine in get_args(Engine):
            classified = classify_ranges(
                block.range_m, config, beam_rad=block.beam_rad, xyz_m=block.xyz_m, engine=engine
            )
            labels[engine] = classified.labels
        n_shots += block.range_m.size
        n_other[preset] = int((labels["compiled"] != labels["reference"]).sum())
        seconds += time.perf_counter() - start
    different = ", ".join(f"{preset} {count:,}" for preset, count in n_other.items() if count)
    yield _check(
        "engines",
        f"compared compiled loops with --engine reference on {n_shots:,} shots in {seconds:.1f} s",
        {"shots": n_shots, "seconds": round(seconds, 3), "different": n_other},
        Fault(
            different,
            "bad",
            f": labels differ ({different}), expected the same",
            "delete the cache folder above and type prc doctor; "
            "until then prc classify --engine reference",
        ),
        Fault(True, "ok", ": the same labels", ""),
    )


def _size(n_bytes: int) -> str:
    """Return bytes in MiB or GiB.

    >>> _size(1 << 30)
    '1.0 GiB'
    """
    if n_bytes < 1 << 30:
        return f"{n_bytes / 2**20:.0f} MiB"
    return f"{n_bytes / 2**30:.1f} GiB"
