"""Preregistration classification of raw mobile laser scanning streams.

The commands call the functions below. All are loaded on first use, so that ``import prc_cli`` is
fast.

>>> import prc_cli
>>> sorted(prc_cli.__all__)
['ClassCodes', 'ClassifiedRanges', 'DoubtWarning', 'EvidenceError', 'Label', 'PrcError',
'calibrate', 'classify', 'classify_ranges', 'convert', 'evaluate', 'evaluate_all', 'find_objects',
'load_config', 'open_stream', 'render', 'simulate', 'stream', 'thin', 'transfer']
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from prc_cli.core.version import __version__ as __version__

if TYPE_CHECKING:
    from prc_cli.config import load_config
    from prc_cli.core.classes import ClassCodes, Label
    from prc_cli.core.errors import DoubtWarning, EvidenceError, PrcError
    from prc_cli.jobs.calibrate import calibrate
    from prc_cli.jobs.classify import ClassifiedRanges, classify, classify_ranges, open_stream
    from prc_cli.jobs.convert import convert
    from prc_cli.jobs.evaluate import evaluate, evaluate_all
    from prc_cli.jobs.objects import find_objects
    from prc_cli.jobs.render import render
    from prc_cli.jobs.simulate import simulate
    from prc_cli.jobs.stream import stream
    from prc_cli.jobs.thin import thin
    from prc_cli.jobs.transfer import transfer

__all__ = [
    "ClassCodes",
    "ClassifiedRanges",
    "DoubtWarning",
    "EvidenceError",
    "Label",
    "PrcError",
    "calibrate",
    "classify",
    "classify_ranges",
    "convert",
    "evaluate",
    "evaluate_all",
    "find_objects",
    "load_config",
    "open_stream",
    "render",
    "simulate",
    "stream",
    "thin",
    "transfer",
]

_HOME = {
    "ClassCodes": "prc_cli.core.classes",
    "DoubtWarning": "prc_cli.core.errors",
    "EvidenceError": "prc_cli.core.errors",
    "Label": "prc_cli.core.classes",
    "PrcError": "prc_cli.core.errors",
    "calibrate": "prc_cli.jobs.calibrate",
    "convert": "prc_cli.jobs.convert",
    "evaluate": "prc_cli.jobs.evaluate",
    "evaluate_all": "prc_cli.jobs.evaluate",
    "find_objects": "prc_cli.jobs.objects",
    "load_config": "prc_cli.config",
    "render": "prc_cli.jobs.render",
    "simulate": "prc_cli.jobs.simulate",
    "stream": "prc_cli.jobs.stream",
    "thin": "prc_cli.jobs.thin",
    "transfer": "prc_cli.jobs.transfer",
}


def __getattr__(name: str) -> Any:
    """Load a public name on first use (PEP 562)."""
    if name not in __all__:
        message = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(message)
    return getattr(import_module(_HOME.get(name, "prc_cli.jobs.classify")), name)


def __dir__() -> list[str]:
    """Return the public names, for completion; nothing is loaded for it."""
    return [*__all__, "__version__"]
