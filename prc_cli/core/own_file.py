"""Small files of our own beside the outputs, such as the last command and the owner of a lock.

They are written whole or not at all. Where a file decides what the program does, it is read only if
nobody but this user and the administrator may change it.
"""

from __future__ import annotations

import errno
import os
import stat
from functools import lru_cache
from pathlib import Path

from prc_cli.core.errors import OutputError
from prc_cli.core.files import atomic_output, read_small, remove_stale


def make_folder(folder: Path) -> None:
    """Make a folder of ours, and those above it, where they are missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"cannot be made ({error.strerror or error})"
        raise OutputError(
            str(folder), problem, "check the output folder and its permissions"
        ) from error


def write_own(path: Path, text: str, *, private: bool = False) -> None:
    """Write a file, or replace it; ``private`` = no other user may read it.

    Bytes of names that are not UTF-8 are escaped.
    """
    remove_stale(path)  # of a run that was killed here
    with atomic_output(path, overwrite=True) as temporary:
        if private:
            temporary.touch(0o600)
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def read_own(path: Path, limit: int) -> bytes:
    """Return the content of a file of at most ``limit`` bytes that only this user may change.

    Links are not followed.

    Raises
    ------
    PermissionError
        If another user may change it.
    OSError
        If it is missing, empty, too long or no regular file.
    """
    if not hasattr(os, "getuid"):
        return read_small(path, limit)
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
    folder = os.open(path.parent, flags | os.O_DIRECTORY)
    try:
        if (owner := os.fstat(folder).st_uid) not in (os.getuid(), 0):
            raise PermissionError(errno.EPERM, f"its folder belongs to user {owner}", str(path))
        descriptor = os.open(path.name, flags, dir_fd=folder)
    finally:
        os.close(folder)
    with open(descriptor, "rb") as handle:  # noqa: PTH123 - a descriptor
        status = os.fstat(descriptor)
        if why := _who_may_change(status):
            raise PermissionError(errno.EPERM, why, str(path))
        content = handle.read(limit + 1) if stat.S_ISREG(status.st_mode) else b""
    if not content or len(content) > limit:
        raise OSError(errno.EINVAL, f"is no file of at most {limit} bytes", str(path))
    return content


def refuse_links(*paths: Path) -> None:
    """Refuse names of our own folder and files that are symbolic links: they may lead anywhere."""
    for path in paths:
        if path.is_symlink():
            problem = "is a symbolic link, expected a folder or file of prc's own"
            raise OutputError(str(path), problem, "look where it leads, then remove it")


def who_may_change(path: Path, *, may_add: bool = False) -> str:
    """Return why users other than this one and root may change a path; empty if none may.

    ``may_add`` = a folder in which others may only add files, as in ``/tmp``, is sound.
    """
    return _who_may_change(path.lstat(), may_add=may_add) if hasattr(os, "getuid") else ""


def _who_may_change(status: os.stat_result, *, may_add: bool = False) -> str:
    if status.st_uid not in (os.getuid(), 0):
        return f"it belongs to user {status.st_uid}"
    mode = stat.S_IMODE(status.st_mode)
    # the mode of a link means nothing
    if stat.S_ISLNK(status.st_mode) or (may_add and mode & stat.S_ISVTX):
        return ""
    is_open = mode & 0o002 or (mode & 0o020 and not _is_group_of_user(status.st_gid))
    return f"its mode is {mode:o}" if is_open else ""


@lru_cache(maxsize=32)
def _is_group_of_user(group: int) -> bool:
    """Whether a group has no other member than this user, or is that of the administrator."""
    import grp
    import pwd

    if group == 0:
        return True
    try:
        members = grp.getgrgid(group)
        name = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # an account without a name, as in containers
        return False
    return members.gr_name == name and not set(members.gr_mem) - {name}
