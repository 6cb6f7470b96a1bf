"""ROS 1 and ROS 2 bags and MCAP files, read in the order they were recorded; no ROS is needed."""

from prc_cli.formats.registry import Format

FORMATS = (Format(name="bag", scans=(".bag", ".db3", ".mcap"), images="prc_cli.formats.bags.read:open_bag"),)
