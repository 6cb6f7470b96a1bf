"""The command line in this process, with stderr apart from stdout in every version of click."""

import inspect

from click.testing import CliRunner


def runner() -> CliRunner:
    """Return a runner; click 8.2 and newer always keep the two apart."""
    is_old = "mix_stderr" in inspect.signature(CliRunner).parameters
    return CliRunner(mix_stderr=False) if is_old else CliRunner()  # type: ignore[call-arg]
