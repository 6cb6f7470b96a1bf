"""Golden outputs: hashes of all files and texts that the commands write, kept in ``golden.json``.

``python -m tests.golden make|check [--only SUBSTRING] [--jobs N] [--folder DIR]``

A case is a list of commands that run in a folder of their own (``tables/``). Files of other cases
are named ``../CASE/FILE``. Cases on the real scans name them ``$DATA/FILE`` and are skipped where
there are none."""
