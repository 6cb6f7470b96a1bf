"""ROS 1 and ROS 2 bags and MCAP files, read in the order they were recorded; no ROS is needed."""

from prc_cli.formats.registry import Format

_SUFFIXES = (".bag", ".db3", ".mcap")
FORMATS = (
    Format(
        name="bag",
        scans=_SUFFIXES,
        images="prc_cli.formats.bags.read:open_bag",
        labels=_SUFFIXES,
        write_labels="prc_cli.formats.bags.labels:BagRewriter",
        codes=_SUFFIXES,
        open_codes="prc_cli.formats.bags.labels:open_bag_codes",
    ),
)
