"""Fixtures shared by several folders of tests."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# The same examples in every run, so that a red run can be repeated; HYPOTHESIS_PROFILE=explore
# looks for new ones. A loop may be compiled inside an example, and the machine may be slow or
# busy: nothing is timed.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "explore", settings.get_profile("repeatable"), derandomize=False, max_examples=2000
)
# tables are as wide as in a pipe, whatever terminal the tests run in
os.environ.pop("COLUMNS", None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


def pytest_configure(config: pytest.Config) -> None:
    """Compile the loops once, on all cores, before workers start.

    Else each would compile them for itself.
    """
    if getattr(config.option, "numprocesses", None) and not config.option.collectonly:
        from prc_cli.core.loops import load_compiler
        from prc_cli.jobs.doctor import every_loop

        load_compiler()
        from prc_cli.core.compiling import compile_missing

        compile_missing(every_loop())


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Give every worker tests that follow each other, so that what a module or folder shares is
    made once."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


def data_folder() -> Path:
    """Folder of the real scans: ``$PRC_DATA``, else ``../shared/data`` beside the checkout."""
    folder = os.environ.get("PRC_DATA")
    return Path(folder) if folder else Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def real_data():
    """Folder of the real scans; absent ones skip the test, but fail it where they are required
    (CI)."""
    folder = data_folder()
    if not folder.is_dir():
        if os.environ.get("PRC_DATA_REQUIRED"):
            pytest.fail(f"PRC_DATA_REQUIRED is set but there are no real scans in {folder}")
        pytest.skip(f"no real scans in {folder}; set PRC_DATA to their folder")
    return folder
