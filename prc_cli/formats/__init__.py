"""File formats, one room each for reading and writing.

:class:`prc_cli.formats.input.Input` says which format a file has; the formats are listed in
:mod:`prc_cli.formats.registry`.
"""

from __future__ import annotations

from prc_cli.formats.input import Input, scan_file
from prc_cli.formats.las import SUFFIXES as LAS_SUFFIXES

__all__ = ["LAS_SUFFIXES", "Input", "scan_file"]
