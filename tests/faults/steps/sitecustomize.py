"""Kills a process of a run just before its n-th step in the output folder, or right after a file
there got its name.

Python imports this module at start.

One file counts the steps of all processes of a run, a byte each. It can also change inputs when a
run opens them, or delay workers there."""

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

_EVENTS = {
    "os.rename",
    "os.remove",
    "os.link",
    "os.mkdir",
    "os.utime",
    "os.truncate",
    "open",
    "sqlite3.connect",
}


_WORKERS = ("prc_cli.jobs.batch.worker", "multiprocessing")
"""In the commands of local workers and of those of Dask."""


def _install(
    out: str,
    counter: str,
    strike_at: int,
    victims: str,
) -> None:
    handle = os.open(counter, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def step(event: str, arguments: tuple[object, ...]) -> None:
        if event not in _EVENTS or not any(_is_below(out, argument) for argument in arguments[:2]):
            return
        if event == "open" and not (
            isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        ):
            return  # to read is no step
        _count(handle, strike_at, victims)

    sys.addaudithook(step)


def _strike_after(
    out: str,
    counter: str,
    strike_at: int,
    victims: str,
) -> None:
    """Kill right after a file got its name."""
    handle = os.open(counter, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def wrapped(naming: Callable[..., None]) -> Callable[..., None]:
        def name(source: object, target: object, **more: object) -> None:
            naming(source, target, **more)
            if _is_below(out, target):
                _count(handle, strike_at, victims)

        return name

    for function in ("link", "rename", "replace"):
        setattr(os, function, wrapped(getattr(os, function)))


def _count(handle: int, strike_at: int, victims: str) -> None:
    os.write(handle, b".")
    if os.lseek(handle, 0, os.SEEK_CUR) == strike_at:
        if victims == "all" and any(of in " ".join(sys.orig_argv) for of in _WORKERS):
            os.kill(os.getppid(), signal.SIGKILL)
        os.kill(os.getpid(), signal.SIGKILL)


def _hold(release: str, paths: list[str]) -> None:
    def hold(event: str, arguments: tuple[object, ...]) -> None:
        for number, path in enumerate(paths if event == "open" else ()):
            if _is_below(path, arguments[0]):
                Path(f"{release}.{number}").touch()
                while not Path(release).exists():
                    time.sleep(0.01)

    sys.addaudithook(hold)


def _let_change(paths: list[str]) -> None:
    def change(event: str, arguments: tuple[object, ...]) -> None:
        if (
            event != "open"
            or not isinstance(arguments[2], int)
            or arguments[2] & (os.O_WRONLY | os.O_RDWR)
        ):
            return
        for path in paths:
            if not _is_below(path, arguments[0]):
                continue
            if path.endswith(".npz"):  # with bytes behind its end it would be damaged
                then = Path(path).stat().st_mtime_ns + 1_000_000_000
                os.utime(path, ns=(then, then))
            else:
                handle = os.open(path, os.O_WRONLY | os.O_APPEND)
                os.write(handle, bytes(100))
                os.close(handle)

    sys.addaudithook(change)


def _is_below(out: str, argument: object) -> bool:
    if isinstance(argument, bytes):
        argument = os.fsdecode(argument)
    if hasattr(argument, "__fspath__"):
        argument = os.fspath(argument)
    return isinstance(argument, str) and argument.startswith(out)


if "PRC_FAULTS_STEPS" in os.environ:
    _out, _counter, _strike_at, _victims = os.environ["PRC_FAULTS_STEPS"].split("|")
    _install(_out, _counter, int(_strike_at), _victims)
if "PRC_FAULTS_NAMES" in os.environ:
    _out, _counter, _strike_at, _victims = os.environ["PRC_FAULTS_NAMES"].split("|")
    _strike_after(_out, _counter, int(_strike_at), _victims)
if "PRC_FAULTS_HOLD" in os.environ and "prc_cli.jobs.batch.worker" in " ".join(sys.orig_argv):
    _release, *_paths = os.environ["PRC_FAULTS_HOLD"].split(os.pathsep)
    _hold(_release, _paths)
if "PRC_FAULTS_CHANGE" in os.environ:
    _let_change(os.environ["PRC_FAULTS_CHANGE"].split(os.pathsep))
