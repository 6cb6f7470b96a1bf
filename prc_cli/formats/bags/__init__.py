"""ROS 1 and ROS 2 bags and MCAP files, read in the order they were recorded; no ROS is needed."""

import contextlib
import re
from pathlib import Path

from prc_cli.core.files import read_small
from prc_cli.formats.registry import Format

_SUFFIXES = (".bag", ".db3", ".mcap")
BAG = "bag"
METADATA = "metadata.yaml"
DATABASE = ".db3"
"""File that makes a ROS 2 recording of the files in its folder, and suffix of these."""


def parts_of(path: Path) -> list[Path]:
    """Return the files of a recording that its ``metadata.yaml`` names, else the file itself."""
    names: list[bytes] = []
    if path.name == METADATA:
        with contextlib.suppress(OSError):
            names = re.findall(rb"[^\s/\"']+\.(?:db3|mcap)", read_small(path, 1 << 20))
    return [path.with_name(name.decode("utf-8", "replace")) for name in dict.fromkeys(names)] or [
        path
    ]


FORMATS = (
    Format(
        name=BAG,
        scans=_SUFFIXES,
        images="prc_cli.formats.bags.read:BagStream",
        streams=dict.fromkeys(
            _SUFFIXES, "laser scans of a profiler, clouds of a spinning scanner, with classes"
        ),
        write_stream="prc_cli.formats.bags.write:BagStreamWriter",
        holds=frozenset(("codes", "relative", "angles", "times", "intensity")),
        labels=_SUFFIXES,
        write_labels="prc_cli.formats.bags.labels:BagRewriter",
        codes=_SUFFIXES,
        open_codes="prc_cli.formats.bags.labels:open_bag_codes",
    ),
)
