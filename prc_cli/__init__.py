"""Preregistration classification of raw mobile laser scanning streams.

The functions below are what the commands themselves call; they are loaded on first use, so that
``import prc_cli`` stays cheap.

>>> import prc_cli
>>> sorted(prc_cli.__all__)
['classify', 'classify_ranges', 'evaluate', 'load_config', 'open_stream']
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from prc_cli.comparison import evaluate
    from prc_cli.config import load_config
    from prc_cli.pipeline import classify, classify_ranges, open_stream

__version__ = "0.1.0"
__all__ = ["classify", "classify_ranges", "evaluate", "load_config", "open_stream"]

_HOME = {"evaluate": "prc_cli.comparison", "load_config": "prc_cli.config"}


def __getattr__(name: str) -> Any:
    """Load a public function on first use (PEP 562)."""
    if name not in __all__:
        message = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(message)
    return getattr(import_module(_HOME.get(name, "prc_cli.pipeline")), name)
