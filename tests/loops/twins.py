"""Finds the slow twin of a loop, and compares the two."""

from collections.abc import Iterator
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from prc_cli.core.errors import ConfigError
from prc_cli.jobs.doctor import every_loop

LOOPS = {loop.name: loop for loop in every_loop()}


def has_twin(name: str) -> bool:
    """Whether a paper describes a loop."""
    try:
        LOOPS[name].reference()
    except ConfigError:
        return False
    return True


def twin_module(name: str) -> ModuleType:
    """Return the module of a loop's twin, where a paper describes it."""
    return import_module(LOOPS[name].reference().__module__)


def twin(name: str) -> Any:
    """Return the slow twin of a loop."""
    return getattr(twin_module(name), name)


def _flat(value: Any) -> Iterator[Any]:
    """Yield what tuples of tuples hold."""
    if isinstance(value, tuple):
        for part in value:
            yield from _flat(part)
    else:
        yield value


def assert_equal_bits(output: Any, expected: Any, tolerance: float = 0.0) -> None:
    """Compare results, one array or a tuple of them, dtypes included.

    a tolerance is for floats alone, absolute.
    """
    output = list(_flat(output))
    expected = list(_flat(expected))
    assert len(output) == len(expected)
    for array, expected_array in zip(output, expected, strict=True):
        assert np.asarray(array).dtype == np.asarray(expected_array).dtype
        if tolerance and np.asarray(array).dtype.kind == "f":
            np.testing.assert_allclose(array, expected_array, rtol=0, atol=tolerance)
        else:
            np.testing.assert_array_equal(array, expected_array)
