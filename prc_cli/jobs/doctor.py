"""Checks of an installation and of a folder for outputs: ``prc doctor``.

Nothing is changed: files written for a check are removed again. A failed check says what to do. Every check imports
what it needs itself, so that a broken package makes only that check fail.
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
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from prc_cli import __version__
from prc_cli.core.errors import PrcError
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.core.profile import peak_memory
from prc_cli.core.threads import default_threads

if TYPE_CHECKING:
    from prc_cli.simulation.settings import Kind

Status: TypeAlias = Literal["ok", "warn", "bad"]

DISTRIBUTION = "prc-cli"
DEVELOPERS = ("test", "docs")
"""Extras for development only."""
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
"""Of ground that is found, and of building that is right, in that run; they are 0.99 and 0.97."""
COMPARED: Mapping[str, tuple[Kind, Mapping[str, Any]]] = {
    "urban": ("street", {"seed": 1, "lines": 120, "scanner": {"points_per_line": 250}}),
    "forest": ("forest", {"seed": 2, "lines": 120, "sight_m": 20.0, "scanner": {"points_per_line": 400}}),
    "street-scan": (
        "street-scan",
        {"seed": 3, "scanner": {"azimuth_step_deg": 4, "points_per_line": 80}, "station": {"turn_deg": 70}},
    ),
}
"""Presets that both engines run, and what on: small scans in which most classes occur."""
_NETWORK = ("nfs", "cifs", "smb", "fuse", "9p", "lustre", "gpfs", "beegfs", "ceph", "afs", "glusterfs", "virtiofs")
"""File systems that several machines may share."""


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check."""

    name: str
    status: Status
    found: str
    """What was found, in a sentence."""
    hint: str = ""
    """What to do; empty if all is well."""
    details: Mapping[str, Any] = field(default_factory=dict)
    """The same as plain values."""


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
        return Check(name, "bad", str(error), "check the disk: its space, its permissions, its mount")
    if isinstance(error, ImportError):
        hint = "install what it names anew: pip install --force-reinstall PACKAGE"
        return Check(name, "bad", f"cannot be loaded ({error})", hint)
    hint = "report it with the output of prc doctor --json"
    return Check(name, "bad", f"{type(error).__name__}: {error}", hint)


def _python() -> Iterator[Check]:
    found = platform.python_version()
    details = {"version": found, "executable": sys.executable, "platform": platform.platform(), "prc": __version__}
    needed = _metadata_value("Requires-Python")
    text = f"prc {__version__}, Python {found} on {platform.system()} {platform.machine()}"
    lower = re.search(r">=\s*([0-9.]+)", needed)
    if lower is not None and _release(found) < _release(lower[1]):
        yield Check("python", "bad", f"{text}, expected Python {needed}", "install a newer Python", details)
        return
    if sys.getfilesystemencoding().lower() != "utf-8":
        hint = "set PYTHONUTF8=1, so that names are printed as they are"
        yield Check("python", "warn", f"{text}; file names are {sys.getfilesystemencoding()}", hint, details)
        return
    yield Check("python", "ok", text, "", details)


def _packages() -> Iterator[Check]:
    """Compare installed versions with the lower bounds in the distribution's metadata."""
    required = [item for item in _requirements() if not item.extra]
    if not required:
        hint = "install it, so that its dependencies are known: pip install prc-cli"
        yield Check("packages", "warn", f"no metadata of {DISTRIBUTION}: run from a source tree", hint)
        return
    old = [item for item in required if not item.is_met]
    details = {item.name: {"found": item.found, "at_least": item.at_least} for item in required}
    if old:
        told = ", ".join(f"{item.name} {item.found or 'missing'} (expected {item.at_least} or newer)" for item in old)
        wanted = " ".join(f"'{item.name}>={item.at_least}'" for item in old)
        yield Check("packages", "bad", told, f"pip install {wanted}", details)
        return
    broken = _broken_packages([item.name for item in required])
    if broken:
        told = ", ".join(f"{name} cannot be loaded ({why})" for name, why in broken.items())
        yield Check("packages", "bad", told, f"pip install --force-reinstall {' '.join(broken)}", details)
        return
    told = ", ".join(f"{item.name} {item.found}" for item in required)
    yield Check("packages", "ok", told, "", details)


def _broken_packages(names: Iterable[str]) -> dict[str, str]:
    """Import packages; return those that are installed but fail to import, and why."""
    modules: dict[str, set[str]] = {}
    for module, distributions in metadata.packages_distributions().items():
        for distribution in distributions:
            if not module.startswith("_"):
                modules.setdefault(distribution.lower(), set()).add(module)
    broken = {}
    for name in names:
        found = modules.get(name.lower(), set())
        # a distribution may also install tests and examples as top-level modules
        module = name if name in found or len(found) != 1 else next(iter(found))
        if module not in found:
            continue
        try:
            importlib.import_module(module)
        except Exception as error:  # an import may raise anything
            broken[name] = f"{type(error).__name__}: {error}"
    return broken


def _extras() -> Iterator[Check]:
    """Report which optional parts are installed."""
    by_extra: dict[str, list[_Requirement]] = {}
    for item in _requirements():
        if item.extra and item.extra not in DEVELOPERS:
            by_extra.setdefault(item.extra, []).append(item)
    if not by_extra:
        return
    told, details, old = [], {}, []
    for extra, items in sorted(by_extra.items()):
        details[extra] = {item.name: item.found for item in items}
        old += [item for item in items if item.found and not item.is_met]
        absent = [item.name for item in items if not item.found]
        versions = ", ".join(f"{item.name} {item.found}" for item in items)
        told.append(f"{extra}: no (pip install '{DISTRIBUTION}[{extra}]')" if absent else f"{extra}: {versions}")
    if old:
        problem = ", ".join(f"{item.name} {item.found} (expected {item.at_least} or newer)" for item in old)
        yield Check("extras", "warn", problem, f"pip install -U {' '.join(item.name for item in old)}", details)
        return
    yield Check("extras", "ok", "; ".join(told), "", details)


@dataclass(frozen=True, slots=True)
class _Requirement:
    name: str
    at_least: str
    extra: str
    found: str
    """Installed version, empty if none."""

    @property
    def is_met(self) -> bool:
        return bool(self.found) and _release(self.found) >= _release(self.at_least)


def _requirements() -> list[_Requirement]:
    try:
        texts = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return []
    found = []
    for text in texts:
        head, _, marker = text.partition(";")
        name = re.match(r"[A-Za-z0-9_.-]+", head)
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)", marker)
        bound = re.search(r">=\s*([0-9][^,;\s)]*)", head)
        if name is None:
            continue
        try:
            version = metadata.version(name[0])
        except metadata.PackageNotFoundError:
            version = ""
        found.append(
            _Requirement(name[0], "0" if bound is None else bound[1], "" if extra is None else extra[1], version)
        )
    return found


def _metadata_value(key: str) -> str:
    try:
        return ", ".join(metadata.metadata(DISTRIBUTION).get_all(key) or [])
    except metadata.PackageNotFoundError:
        return ""


def _release(version: str) -> tuple[int, ...]:
    """Return the numbers of a version, without trailing zeros and suffixes (rc1, .dev0)."""
    numbers = [int(part) for part in re.findall(r"\d+", re.match(r"[\d.]*", version.split("+")[0])[0])]  # type: ignore[index]
    while numbers and not numbers[-1]:
        numbers.pop()
    return tuple(numbers)


def _laz() -> Iterator[Check]:
    from prc_cli.formats.las.check import POINT_FORMATS, check_laz

    for point_format in POINT_FORMATS:
        check_laz(point_format)
    version = metadata.version("lazrs")
    formats = ", ".join(str(number) for number in POINT_FORMATS)
    yield Check("LAZ", "ok", f"lazrs {version}, records of formats {formats} came back as they went in")


def _processor() -> Iterator[Check]:
    from prc_cli.kernels import load_compiler

    load_compiler()
    from prc_cli.kernels.compiling import about

    found, usable, all_cores = about(), default_threads(), os.cpu_count() or 1
    features = ", ".join(found.features) or "no vector instructions"
    cores = f"{usable} of {all_cores} cores" if usable < all_cores else f"{usable} cores"
    text = f"{cores}, {found.processor} ({features})"
    details = {"cores": usable, "of": all_cores, "processor": found.processor, "features": list(found.features)}
    if not found.compiles:
        hint = "unset NUMBA_DISABLE_JIT: loops run a hundred times slower"
        yield Check("processor", "bad", f"{text}; compiling is turned off", hint, details)
        return
    load = _load()
    if load is not None and load > 2 * all_cores:
        hint = "wait, or take fewer files at a time with --jobs"
        yield Check("processor", "warn", f"{text}; {load:.0f} processes want them", hint, details)
        return
    yield Check("processor", "ok", text, "", details)


def _load() -> float | None:
    try:
        return os.getloadavg()[0]
    except (OSError, AttributeError):  # not on this system
        return None


def _cache() -> Iterator[Check]:
    from prc_cli.kernels import load_compiler

    load_compiler()
    from prc_cli.kernels.compiling import cache_state

    found = cache_state()
    details = {
        "folder": None if found.folder is None else str(found.folder),
        "bytes": found.n_bytes,
        "compiled": found.n_compiled,
        "modules": found.n_modules,
    }
    if found.folder is None:
        hint = "set NUMBA_CACHE_DIR to a folder that this user can write: else every run compiles for half a minute"
        yield Check("compiled loops", "warn", "no folder to keep them can be written", hint, details)
        return
    free = shutil.disk_usage(found.folder).free
    text = f"{found.n_compiled} of {found.n_modules} modules compiled, {_size(found.n_bytes)} in {found.folder}"
    if free < CACHE_BYTES:
        hint = "free space, or set NUMBA_CACHE_DIR to a folder on another disk"
        yield Check("compiled loops", "warn", f"{text}, {_size(free)} free", hint, details)
    elif not os.environ.get("NUMBA_CACHE_DIR") and _is_within(found.folder, Path(tempfile.gettempdir())):
        hint = "set HOME, XDG_CACHE_HOME or NUMBA_CACHE_DIR: temporary folders are emptied"
        yield Check("compiled loops", "warn", text, hint, details)
    else:
        yield Check("compiled loops", "ok", text, "", details)


def _is_within(path: Path, folder: Path) -> bool:
    return path.resolve().is_relative_to(folder.resolve())


def _memory() -> Iterator[Check]:
    free = _free_memory()
    if free is None:
        return
    cores = default_threads()
    text = f"{_size(free)} free for {cores} cores"
    details = {"free_bytes": free}
    if free < MEMORY_BYTES:
        yield Check("memory", "bad", text, "end other programs, or give the container more", details)
    elif free < cores * MEMORY_BYTES:
        hint = f"take at most {max(1, free // MEMORY_BYTES)} files at a time with --jobs"
        yield Check("memory", "warn", text, hint, details)
    else:
        yield Check("memory", "ok", text, "", details)


def _free_memory() -> int | None:
    """Return the memory still available [bytes], to the machine and its container (control groups version 2, 1)."""
    found = []
    with contextlib.suppress(OSError, ValueError, IndexError):
        text = Path("/proc/meminfo").read_text(encoding="ascii")
        found.append(int(text.partition("MemAvailable:")[2].split()[0]) << 10)
    if not found:
        with contextlib.suppress(OSError, ValueError, AttributeError):
            found.append(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    groups = Path("/sys/fs/cgroup")
    for limit, used in (
        ("memory.max", "memory.current"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),
    ):
        with contextlib.suppress(OSError, ValueError):
            found.append(int((groups / limit).read_text()) - int((groups / used).read_text()))
    return max(0, min(found)) if found else None


def _temporary() -> Iterator[Check]:
    folder = Path(tempfile.gettempdir())
    free = shutil.disk_usage(folder).free
    details = {"folder": str(folder), "free_bytes": free}
    with tempfile.TemporaryFile(dir=folder) as handle:
        handle.write(b"x")
    text = f"{_size(free)} free in {folder}"
    given = os.environ.get("TMPDIR")
    if given and Path(given) != folder:
        hint = f"make the folder, or let TMPDIR name another: mkdir -p {given}"
        yield Check("temporary files", "warn", f"{text}, since TMPDIR={given} cannot be used", hint, details)
    elif free < DISK_BYTES:
        hint = "set TMPDIR to a folder on a larger disk: --sort-by-time and --match sort there"
        yield Check("temporary files", "warn", text, hint, details)
    else:
        yield Check("temporary files", "ok", text, "", details)


def _output(out: Path) -> Iterator[Check]:
    """Check a folder for the needs of a batch run."""
    from prc_cli.jobs.batch.types import OWN_FOLDER

    folder = out
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    name = f"output folder {out}"
    if not folder.is_dir():
        yield Check(name, "bad", f"{folder} is no folder", "choose another output folder")
        return
    try:
        trial = Path(tempfile.mkdtemp(prefix=".prc-doctor-", dir=folder))
    except OSError as error:
        yield Check(
            name, "bad", f"cannot be written ({error.strerror or error})", "change its permissions, or choose another"
        )
        return
    try:
        yield _space(out, folder)
        yield _links(trial)
        yield _sqlite(trial)
        yield _names(trial)
    finally:
        shutil.rmtree(trial, ignore_errors=True)
    if (out / OWN_FOLDER).is_dir():
        yield _runs(out / OWN_FOLDER)


def _runs(folder: Path) -> Check:
    """Check the journal of earlier runs; raises if it is damaged."""
    from prc_cli.jobs.batch.journal import read_entries
    from prc_cli.jobs.batch.lock import holders

    name = "earlier runs"
    entries, owners = read_entries(folder), holders(folder)
    states = Counter(entry.state for entry in entries)
    versions = sorted({entry.version for entry in entries})
    text = ", ".join(f"{count:,} {state}" for state, count in sorted(states.items())) or "no files"
    details = {
        "files": dict(states),
        "versions": versions,
        "at_work": [str(item.owner) for item in owners if item.alive],
    }
    for found in owners:
        if found.alive:
            return Check(name, "ok", f"{text}; at work: {found.owner}", "", details)
    if set(versions) - {__version__}:
        hint = "they are done again; --keep-version leaves them, see the page on operations"
        return Check(name, "warn", f"{text}; some by version {', '.join(versions)}", hint, details)
    return Check(name, "ok", text, "", details)


def _space(out: Path, folder: Path) -> Check:
    free, kind = shutil.disk_usage(folder).free, file_system(folder)
    text = f"{_size(free)} free on {kind or 'an unknown file system'}" + (
        "" if folder == out else f" ({folder}; it is new)"
    )
    details = {"folder": str(folder), "free_bytes": free, "file_system": kind}
    if free < DISK_BYTES:
        return Check("output disk", "warn", text, "free space: see the disk budget in the page on operations", details)
    return Check("output disk", "ok", text, "", details)


def _links(trial: Path) -> Check:
    """Try the file operations that the lock of a batch run and atomic outputs use."""
    from prc_cli.jobs.batch.lock import has_locks

    name = "locks in it"
    first, second = trial / "first", trial / "second"
    before = time.time()
    with first.open("xb") as handle:
        handle.write(b"x")
        handle.flush()
        os.fsync(handle.fileno())
    clock_s = first.stat().st_mtime - before
    try:
        os.link(first, second)
        linked = True
    except OSError:
        linked = False
    try:
        first.open("xb").close()
    except FileExistsError:
        pass
    else:
        return Check(name, "bad", "a file that exists could be created anew", "use another disk: two runs could meet")
    third = trial / "third"
    third.write_bytes(b"y")
    third.replace(first)
    if third.exists() or first.read_bytes() != b"y" or (linked and second.read_bytes() != b"x"):
        return Check(name, "bad", "a file did not replace another one whole", "use another disk for outputs")
    locks = has_locks(trial)
    details = {"locks": locks, "hard_links": linked, "clock_s": round(clock_s, 3)}
    if not locks:
        hint = "prc batch refuses it: choose another disk; Lustre: mount it with -o flock"
        return Check(name, "bad", "the file system has no file locks", hint, details)
    if abs(clock_s) > CLOCK_S:
        text = f"exclusive files and renaming work; the clock of the file server is {clock_s:+.0f} s off"
        return Check(name, "warn", text, "let both keep time with NTP: --since and changed inputs go by it", details)
    return Check(name, "ok", f"locks, exclusive files, renaming{' and hard links' * linked} work", "", details)


def _sqlite(trial: Path) -> Check:
    """Write like the journal, while a second connection reads."""
    name, path = "journal in it", trial / "journal.sqlite"
    kind = file_system(trial)
    with contextlib.closing(sqlite3.connect(path, timeout=2.0, isolation_level=None)) as one:
        one.execute("PRAGMA synchronous=EXTRA")
        one.execute("CREATE TABLE trial (n INTEGER)")
        one.execute("BEGIN IMMEDIATE")
        one.execute("INSERT INTO trial VALUES (1)")
        one.execute("COMMIT")
        with contextlib.closing(sqlite3.connect(path, timeout=2.0)) as other:
            n = other.execute("SELECT count(*) FROM trial").fetchone()[0]
    details = {"sqlite": sqlite3.sqlite_version, "file_system": kind}
    text = f"SQLite {sqlite3.sqlite_version}"
    if n != 1:
        return Check(
            name, "bad", f"{text}: what was written was not read back", "use another disk for outputs", details
        )
    if kind.startswith(_NETWORK):
        hint = "several machines may share it with --shard i/n, which gives each a journal of its own"
        return Check(name, "warn", f"{text} on {kind}, which is a network's", hint, details)
    return Check(name, "ok", text, "", details)


def _names(trial: Path) -> Check:
    """Try file names as they occur in archives."""
    name = "file names in it"
    tried = {"Latin-1": b"stra\xdfe", "a line feed": b"a\nb", "a colon": b"a:b", "200 bytes": b"n" * 200}
    refused = []
    for what, raw in tried.items():
        path = trial / os.fsdecode(raw)
        try:
            path.write_bytes(b"")
            if path not in trial.iterdir():
                refused.append(what)
        except (OSError, ValueError):
            refused.append(what)
    (trial / "case").write_bytes(b"")
    folds = (trial / "CASE").exists()
    details = {"refused": refused, "ignores_case": folds}
    if refused or folds:
        told = [f"names with {what} are refused" for what in refused] + ["names that differ in case are one"] * folds
        hint = "inputs with such names fail, or are refused before the run"
        return Check(name, "warn", ", ".join(told), hint, details)
    return Check(name, "ok", f"{', '.join(tried)} and upper case are kept", "", details)


def file_system(folder: Path, mounts: Path = Path("/proc/self/mounts")) -> str:
    """Return the type of a folder's file system, empty where the system does not report it."""
    try:
        lines = mounts.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return ""
    place, found, longest = folder.resolve(), "", -1
    for line in lines:
        fields = line.split(" ")
        if len(fields) < 3:
            continue
        # blanks in names are octal escapes there; the last mount of a folder hides earlier ones
        point = Path(re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), fields[1]))
        if len(point.parts) >= longest and place.is_relative_to(point):
            longest, found = len(point.parts), fields[2]
    return found


def _end_to_end() -> Iterator[Check]:
    """Simulate a street, classify it from LAZ to LAZ, evaluate it, and read the classes with another library."""
    from prc_cli.config import load_config
    from prc_cli.evaluation.scores import gate_value, scores
    from prc_cli.formats.las.check import classes_by_laspy
    from prc_cli.jobs.classify import classify, load_classifier
    from prc_cli.jobs.evaluate import evaluate
    from prc_cli.jobs.simulate import simulate
    from prc_cli.simulation.drive import load_simulator
    from prc_cli.simulation.settings import load_settings

    start = time.perf_counter()
    config = load_config(preset="urban", options={"input": {"order": "trust"}})
    load_simulator()
    load_classifier(config)
    loaded = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="prc-doctor-") as name:
        scan, output = Path(name, "street.laz"), Path(name, "classified.laz")
        options = {"lines": LINES, "seed": 1, "scanner": {"points_per_line": 1000}}
        simulate("street", scan, load_settings("street", options=options))
        summary = classify(scan, output, config)
        found = scores(evaluate(output, scan))
        by_laspy = classes_by_laspy(output)
        values = {name: gate_value(found, name) for name in ("recall.ground", "precision.building")}
    seconds = time.perf_counter() - loaded
    n_shots = summary.counts.n_shots
    written = {item.code: item.count for item in summary.record.classes}
    peak = peak_memory()
    details = {
        "shots": n_shots,
        "seconds": round(seconds, 3),
        "loading_s": round(loaded - start, 3),
        "scores": {name: round(value, 4) for name, value in values.items()},
        "peak_memory_bytes": peak,
    }
    told = ", ".join(f"{name} {value:.2f}" for name, value in values.items())
    text = (
        f"a street of {n_shots:,} shots simulated, classified from LAZ to LAZ and evaluated in {seconds:.1f} s "
        f"({told}); {loaded - start:.1f} s to load the loops"
    )
    if not min(values.values()) >= LEAST_SCORE:
        hint = "the compiled loops are wrong on this machine: remove the cache named above, and report it"
        yield Check("end to end", "bad", f"{text}; expected at least {LEAST_SCORE} of both", hint, details)
        return
    if by_laspy != written:
        hint = "report it, with the versions above"
        yield Check("end to end", "bad", f"{text}; laspy reads other classes than were written", hint, details)
        return
    yield Check("end to end", "ok", f"{text}; laspy reads the same classes", "", details)


def _engines() -> Iterator[Check]:
    """Classify small simulated scans with the compiled loops and with their plain twins."""
    from prc_cli.config import load_config
    from prc_cli.core.blocks import join
    from prc_cli.jobs.classify import classify_ranges, load_classifier
    from prc_cli.simulation.settings import load_settings, open_simulation

    n_shots, n_other, seconds = 0, {}, 0.0
    for preset, (kind, options) in COMPARED.items():
        # labels are compared, not believed: the scans are coarse, and mostly noise with some presets
        config = load_config(preset=preset, options={"input": {"accept_doubts": CHECK_NAMES}})
        load_classifier(config)
        start = time.perf_counter()
        block = join(list(open_simulation(kind, load_settings(kind, options=options), threads=1).scan.blocks()))
        compiled = classify_ranges(block.range_m, config, beam_rad=block.beam_rad, xyz_m=block.xyz_m).labels
        plain = classify_ranges(
            block.range_m, config, beam_rad=block.beam_rad, xyz_m=block.xyz_m, engine="reference"
        ).labels
        n_shots += block.range_m.size
        n_other[preset] = int((compiled != plain).sum())
        seconds += time.perf_counter() - start
    details = {"shots": n_shots, "seconds": round(seconds, 3), "different": n_other}
    text = f"{n_shots:,} shots by compiled loops and by --engine reference ({', '.join(COMPARED)}) in {seconds:.1f} s"
    if any(n_other.values()):
        told = ", ".join(f"{preset} {count:,}" for preset, count in n_other.items() if count)
        hint = "remove the cache named above and run prc doctor again; until then prc classify --engine reference"
        yield Check("engines", "bad", f"{text}: labels differ ({told}), expected the same", hint, details)
        return
    yield Check("engines", "ok", f"{text}: the same labels", "", details)


def _size(n_bytes: int) -> str:
    """Return bytes for people.

    >>> _size(1536 << 20)
    '1.5 GiB'
    """
    if n_bytes < 1 << 30:
        return f"{n_bytes / 2**20:.0f} MiB"
    return f"{n_bytes / 2**30:.1f} GiB"
