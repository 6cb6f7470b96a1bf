"""Hostile input: small files of every format, ways to damage them, and guarded processes that read
them.

``python -m tests.fuzz.campaign`` tries many damaged files in watched worker processes and looks for
new ways through the parsers. What it found is kept in ``found`` and ``test_found.py``."""
