"""What an output must be like, said by other programs and by the library in memory."""

from pathlib import Path
from typing import Any

import laspy
import numpy as np

from prc_cli.cli import _run
from tests.fuzz.targets import LABELLED, arguments


def judge_content(command: str, case: Path, out: Path, scratch: Path) -> list[str]:
    """Compare an output with what other ways to it give."""
    faults = judge_las(command, case, out)
    if faults or command != LABELLED:
        return faults
    labels = np.load(out / "o.npy")
    return judge_read(case, labels, scratch)


def read_las(path: Path) -> tuple[Any, BaseException | None]:
    """Read a file with laspy; return it, or why it cannot be read."""
    try:
        return laspy.read(path), None
    except BaseException as error:  # a panic of lazrs is no Exception
        return None, error


def judge_las(command: str, case: Path, out: Path) -> list[str]:
    """Read LAS and LAZ outputs with laspy.

    Of a file that was copied everything but the class is as it was.
    """
    faults = []
    before, refusal = read_las(case) if case.suffix in (".las", ".laz") else (None, None)
    for path in (*out.glob("*.las"), *out.glob("*.laz")):
        cloud, error = read_las(path)
        if error is not None:
            # headers that it refuses and we do not are copied as they are; records must be sound
            name = type(error).__name__
            if type(refusal) is not type(error) or "Lazrs" in name or "Panic" in name:
                faults.append(f"laspy refuses the output: {name}: {error}"[:300])
        elif before is not None and command.startswith(("classify", "convert")):
            faults += _differences(before, cloud)
    return faults


def _differences(before: Any, after: Any) -> list[str]:
    if len(before.points) != len(after.points):
        return [f"{len(after.points)} records of {len(before.points)}"]
    if before.point_format.id != after.point_format.id:
        return []
    old = before.points.array
    new = after.points.array
    same = set(old.dtype.names) & set(new.dtype.names) - {"classification", "raw_classification"}
    return [
        f"{name} differs"
        for name in sorted(same)
        if old[name].dtype == new[name].dtype and old[name].tobytes() != new[name].tobytes()
    ]


def judge_read(case: Path, labels: np.ndarray, scratch: Path) -> list[str]:
    """Let laspy decode everything and write it anew; the labels must be the same."""
    if case.suffix not in (".las", ".laz"):
        return []
    cloud, error = read_las(case)
    if error is not None or len(cloud.points) != len(labels):
        return []
    again = scratch / "again.las"
    cloud.evlrs = None
    try:
        cloud.write(again)
    except Exception:  # of a header that can be read and not written
        return []
    if _run(arguments(LABELLED, again, scratch, scratch), debug=False) not in (0, 4):
        return []
    codes = np.load(scratch / "o.npy")
    n = np.count_nonzero(codes != labels) if codes.shape == labels.shape else -1
    return [f"labels: {n} of {len(labels)} differ from those of what laspy read"] if n else []
