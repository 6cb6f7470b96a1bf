"""Hostile input: small files of every format, ways to damage them, and guarded processes that read them.

``python -m tests.fuzz.campaign`` tries many damaged files in watched worker processes,
``python -m tests.fuzz.coverage`` lets atheris look for new paths through one reader. What they found is kept in
``test_found.py``.
"""
