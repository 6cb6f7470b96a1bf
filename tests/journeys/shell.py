"""Commands typed in a folder as a user types them.

In this process, or the installed one in its own.
"""

import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prc_cli.cli import main

COMMAND = Path(sys.executable).with_name("prc.exe" if os.name == "nt" else "prc")
CLASSES = ("ground", "building", "vegetation", "noise")


@dataclass(frozen=True, slots=True)
class Said:
    """What a command printed, and its exit code."""

    code: int
    out: str
    err: str

    def command(self, what: str) -> str:
        """Return the command line that is offered behind a word.

        ``type:``, ``draw it:``, ``compare it:``.
        """
        match = re.search(rf"^{what}: (prc .*)$", self.out + self.err, re.MULTILINE)
        assert match, f"no {what!r} in:\n{self.out}{self.err}"
        return match[1]


@dataclass(frozen=True, slots=True)
class Shell:
    """A folder in which commands are typed."""

    here: Path
    installed: bool = False
    """Whether every command is a process of its own, which takes a second to start."""

    def __call__(self, line: str, code: int = 0) -> Said:
        """Run a command line that begins with ``prc``; it must end with this exit code."""
        words = shlex.split(line)[1:]
        if self.installed:
            done = subprocess.run(
                [COMMAND, *words], cwd=self.here, capture_output=True, timeout=600, check=False
            )
            said = Said(
                done.returncode, done.stdout.decode("utf-8", "replace"), done.stderr.decode()
            )
        else:
            out = io.StringIO()
            err = io.StringIO()
            with (
                contextlib.chdir(self.here),
                contextlib.redirect_stdout(out),
                contextlib.redirect_stderr(err),
            ):
                try:
                    main(words)
                except SystemExit as left:
                    said = Said(int(left.code or 0), out.getvalue(), err.getvalue())
        assert said.code == code, (
            f"{line}\nexit code {said.code}, expected {code}\n{said.out[-3000:]}{said.err[-3000:]}"
        )
        return said

    def labels(self, name: str) -> NDArray[np.uint8]:
        """Return labels that were written as ``.npy``."""
        labels: NDArray[np.uint8] = np.load(self.here / name).ravel()
        return labels

    def f1(self, predicted: str, reference: str) -> dict[str, float]:
        """Return F1 by class, as ``prc evaluate`` has it."""
        said = self(f"prc evaluate {predicted} {reference} --json -q")
        return {
            name: scores["f1"] or 0.0 for name, scores in json.loads(said.out)["classes"].items()
        }
