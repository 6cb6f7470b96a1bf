"""An audit hook against what a reader must never do.

Execute, load pickles, use the network, write elsewhere.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType
from typing import Any

import prc_cli
from prc_cli.core import compiling
from prc_cli.methods.fused import thresholds

FORBIDDEN = (
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.spawn",
    "os.fork",
    "os.startfile",
    "subprocess.Popen",
    "socket.",
    "ctypes.dlopen",
    "pty.spawn",
)
CHANGES = {
    "os.remove": 1,
    "os.rename": 2,
    "os.mkdir": 1,
    "os.rmdir": 1,
    "os.link": 2,
    "os.symlink": 2,
    "os.truncate": 1,
    "os.chmod": 1,
    "os.chown": 1,
    "shutil.rmtree": 1,
    "shutil.move": 2,
}
"""Events whose first arguments are names of files that are changed."""
OWN = (compiling.__file__, thresholds.__file__)
"""The one begins processes that compile loops, once after installation.

The other reads types of its own fields.
"""
TEMPLATES = tuple(
    Path(prc_cli.__path__[0], room, "templates") for room in ("evaluation", "imaging")
)
"""The program's own pages, which jinja2 turns into code."""
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_TRUNC


class Guard:
    """An audit hook that can be armed; what it sees while armed is kept in :attr:`seen`.

    Parameters
    ----------
    folders : tuple of Path
        Where files may be written.
    """

    def __init__(self, folders: tuple[Path, ...]) -> None:
        self._folders = tuple(f"{folder.resolve()}{os.sep}" for folder in folders)
        self._armed = self._inside = False
        self.seen: list[str] = []
        # a hook can never be removed
        sys.addaudithook(self._hook)

    @contextlib.contextmanager
    def armed(self) -> Iterator[list[str]]:
        """Watch what happens in the block, in every thread."""
        self.seen = []
        self._armed = True
        try:
            yield self.seen
        finally:
            self._armed = False

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self._armed or self._inside:
            return
        self._inside = True
        try:
            if fault := self._judge(event, arguments):
                self.seen.append(fault)
        finally:
            self._inside = False

    def _judge(self, event: str, arguments: tuple[Any, ...]) -> str:
        if event == "open":
            name, _, flags = arguments
            return f"open {name!r} to write" if flags & _WRITES and not self._allowed(name) else ""
        if event in CHANGES:
            # what is relative to an open folder was judged when its parent was opened
            names = (
                arguments[: CHANGES[event]]
                if arguments[-1] in (-1, None) or event.startswith("shutil")
                else ()
            )
            outside = [name for name in names if not self._allowed(name)]
            return f"{event} {outside!r}" if outside else ""
        if event.startswith(FORBIDDEN):
            is_process = event == "ctypes.dlopen" and arguments[0] is None  # the process itself
            return "" if is_process or _is_import() else f"{event} {arguments!r}"[:300]
        if event == "exec":
            code = arguments[0]
            plain = isinstance(code, CodeType) and (
                Path(code.co_filename).suffix == ".py" or Path(code.co_filename).parent in TEMPLATES
            )
            return "" if plain or _is_import() else f"exec {code!r}"[:300]
        if event == "pickle.find_class":
            return "" if _is_import() else f"pickle {arguments!r}"[:300]
        return ""

    def _allowed(self, name: Any) -> bool:
        if isinstance(name, int):
            return True  # a descriptor that is open already
        path = os.path.abspath(os.fsdecode(name))  # noqa: PTH100 - links are not to be followed to the end
        # the folder itself is opened for a file without a name (O_TMPFILE)
        places = Path(path).resolve(), Path(path).parent.resolve()
        return (
            any(f"{place}{os.sep}".startswith(self._folders) for place in places)
            or path == os.devnull
        )


def _is_import() -> bool:
    """Whether modules of the program are being loaded, or its own compiled loops.

    They run code and load pickles.
    """
    frame = sys._getframe(2)
    while frame is not None:
        name = frame.f_code.co_filename
        if "importlib._bootstrap" in name or f"{os.sep}numba{os.sep}" in name or name in OWN:
            return True
        frame = frame.f_back  # type: ignore[assignment]
    return False


def unprintable(text: str) -> str:
    """Return the characters that must not reach a terminal.

    Control characters, turns of direction, surrogates.
    """
    return "".join(sorted({c for c in text if not c.isprintable() and c != "\n"}))
