"""An audit hook against what a reader must never do.

Execute, load pickles, use the network, write elsewhere.
"""

import os
import sys
from pathlib import Path
from types import CodeType
from typing import Any

import prc_cli
from prc_cli.core import compiling
from prc_cli.methods.fused import thresholds

FORBIDDEN = (
    *("os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.startfile"),
    *("subprocess.Popen", "socket.", "ctypes.dlopen", "pty.spawn", "pickle.find_class"),
)
CHANGES = {
    **dict.fromkeys(("os.rename", "os.link", "os.symlink", "shutil.move"), 2),
    **dict.fromkeys(("os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.chmod"), 1),
    **dict.fromkeys(("os.chown", "shutil.rmtree"), 1),
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


def watch(folders: tuple[Path, ...]) -> list[str]:
    """Watch this process until it ends: a hook can never be removed.

    Return the list that gets what must not happen. Files may be written in ``folders``.
    """
    allowed = tuple(f"{folder.resolve()}{os.sep}" for folder in folders)
    seen: list[str] = []
    is_inside = False

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal is_inside
        if not is_inside:
            is_inside = True
            try:
                if fault := _judge(event, arguments, allowed):
                    seen.append(fault)
            finally:
                is_inside = False

    sys.addaudithook(hook)
    return seen


def _judge(event: str, arguments: tuple[Any, ...], folders: tuple[str, ...]) -> str:
    if event == "open":
        name, _, flags = arguments
        return f"open {name!r} to write" if flags & _WRITES and not _lies_in(name, folders) else ""
    if event in CHANGES:
        # what is relative to an open folder was judged when its parent was opened
        is_absolute = arguments[-1] in (-1, None) or event.startswith("shutil")
        names = arguments[: CHANGES[event]] if is_absolute else ()
        outside = [name for name in names if not _lies_in(name, folders)]
        return f"{event} {outside!r}" if outside else ""
    if event == "exec":
        code = arguments[0]
        if isinstance(code, CodeType):
            path = Path(code.co_filename)
            if path.suffix == ".py" or path.parent in TEMPLATES:
                return ""
    elif not event.startswith(FORBIDDEN) or arguments == (None,):  # the process itself is loaded
        return ""
    return "" if _is_import() else f"{event} {arguments!r}"[:300]


def _lies_in(name: Any, folders: tuple[str, ...]) -> bool:
    if isinstance(name, int):
        return True  # a descriptor that is open already
    path = os.path.abspath(os.fsdecode(name))  # noqa: PTH100 - links are not to be followed to the end
    # the folder itself is opened for a file without a name (O_TMPFILE)
    places = Path(path).resolve(), Path(path).parent.resolve()
    return path == os.devnull or any(f"{place}{os.sep}".startswith(folders) for place in places)


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
