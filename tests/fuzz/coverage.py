"""Let atheris look for new paths through a reader: ``python -m tests.fuzz.coverage TARGET --runs N --seconds S``.

The Python code of the readers is instrumented, so that a case that takes a new path is kept and damaged further, with
the ways of ``mutations.py`` and with those of libFuzzer. Files are read completely by functions of the library, without
command line and classifier. The corpus in ``--corpus`` is kept for the next run. An exception other than a refusal, a
minute of wall time or 3 GiB end the run, and the case is written to ``--keep``.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from pathlib import Path

from tests.fuzz.mutations import mutate
from tests.fuzz.seeds import seed
from tests.fuzz.targets import TARGETS, suffix_of_seed

MAX_BYTES = 1 << 18


def main() -> None:
    """Hand everything over to libFuzzer, which ends the process."""
    targets = [name for name in TARGETS if name not in ("stream", "simulate")]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", choices=targets)
    parser.add_argument("--runs", type=int, default=-1)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--corpus", type=Path, default=None)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-found"))
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    seeds = TARGETS[given.target].seeds
    scratch = Path(tempfile.mkdtemp(prefix="prc-coverage-"))
    corpus = given.corpus or scratch / "corpus"
    for folder in (corpus, given.keep):
        folder.mkdir(parents=True, exist_ok=True)
    suffixes = sorted({suffix_of_seed(name) for name in seeds})
    for name in seeds:
        # the first byte says which suffix the file has
        (corpus / f"seed-{name}").write_bytes(bytes([suffixes.index(suffix_of_seed(name))]) + seed(name))
    import atheris

    with atheris.instrument_imports(include=["prc_cli", "tomllib", "tests.fuzz.reads"], exclude=["prc_cli.kernels"]):
        from prc_cli.core.errors import PrcError
        from tests.fuzz.reads import READS, blocks
    read = READS.get(given.target, blocks)

    def one(data: bytes) -> None:
        if len(data) < 2:
            return
        case = scratch / f"case{suffixes[data[0] % len(suffixes)]}"
        case.write_bytes(data[1:])
        try:
            read(case)
        except PrcError:
            return

    def damage(data: bytes, max_size: int, number: int) -> bytes:
        rng = random.Random(number)
        if len(data) < 2 or rng.random() < 0.3:
            return bytes(atheris.Mutate(data, max_size))
        return data[:1] + mutate(data[1:], suffixes[data[0] % len(suffixes)], number)[: max_size - 1]

    options = [
        sys.argv[0],
        f"-runs={given.runs}",
        f"-max_total_time={given.seconds}",
        f"-max_len={MAX_BYTES}",
        f"-seed={given.seed}",
        "-timeout=10",
        "-rss_limit_mb=3072",
        "-print_final_stats=1",
        "-len_control=0",
        f"-artifact_prefix={given.keep}/{given.target}-",
        str(corpus),
    ]
    atheris.Setup(options, one, custom_mutator=damage)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
