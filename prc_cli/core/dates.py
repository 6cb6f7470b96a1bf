"""The day that stands on pictures and pages."""

from __future__ import annotations

import os
from datetime import UTC, datetime

from prc_cli.core.errors import ConfigError

EPOCH = "SOURCE_DATE_EPOCH"
"""Variable that sets the day, so that equal runs give equal bytes on any day [seconds since 1970, UTC] (specification
of reproducible-builds.org)."""


def today() -> str:
    """Return the day in UTC, of ``SOURCE_DATE_EPOCH`` if it is set.

    >>> len(today())
    10
    """
    given = os.environ.get(EPOCH)
    if not given:
        return f"{datetime.now(UTC):%Y-%m-%d}"
    try:
        return f"{datetime.fromtimestamp(int(given), UTC):%Y-%m-%d}"
    except (ValueError, OverflowError, OSError) as error:
        problem = f"found {given!r}, expected whole seconds since 1970"
        raise ConfigError(EPOCH, problem, "unset the variable, or set it to a number") from error
