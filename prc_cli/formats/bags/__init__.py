"""ROS 1 and ROS 2 bags and MCAP files, read in the order they were recorded; no ROS and no bag library is needed."""

SUFFIXES = (".bag", ".db3", ".mcap")
"""Kept apart from the readers, which load pyarrow and sqlite3: 27 MiB that no other input needs."""
