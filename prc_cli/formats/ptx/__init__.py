"""PTX, organised scans as text."""

from prc_cli.formats.registry import Format

FORMATS = (Format(name="PTX", scans=(".ptx",), images="prc_cli.formats.ptx.read:open_ptx"),)
