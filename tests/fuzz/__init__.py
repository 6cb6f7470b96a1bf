"""Hostile input: small files of every format, ways to damage them, and guarded processes that read
them.

``test_hostile.py`` draws damaged files with hypothesis. Files that once showed a fault are kept in
``found`` and in ``test_found.py``."""
