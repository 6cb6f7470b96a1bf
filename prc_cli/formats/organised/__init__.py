"""Organised scans, rows by columns: PTX as text, and E57 (ASTM E2807) in a binary container."""

from prc_cli.formats.registry import Format

FORMATS = (
    Format(name="PTX", scans=(".ptx",), images="prc_cli.formats.organised.ptx:PtxStream"),
    Format(name="E57", scans=(".e57",), images="prc_cli.formats.organised.e57_read:E57Stream"),
)
