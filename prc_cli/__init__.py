"""Preregistration classification of raw mobile laser scanning streams.

The functions below are what the commands themselves call; they are loaded on first use, so that
``import prc_cli`` stays cheap.

>>> import prc_cli
>>> sorted(prc_cli.__all__)
['calibrate', 'classify', 'classify_ranges', 'convert', 'evaluate', 'evaluate_all', 'load_config', 'open_stream', \
'render', 'simulate', 'stream', 'thin', 'transfer']
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from prc_cli.calibration.calibrate import calibrate
    from prc_cli.comparison import evaluate, evaluate_all
    from prc_cli.config import load_config
    from prc_cli.conversion import convert
    from prc_cli.label_transfer import transfer
    from prc_cli.pipeline import classify, classify_ranges, open_stream
    from prc_cli.rendering import render
    from prc_cli.simulated_files import simulate
    from prc_cli.streaming import stream
    from prc_cli.thinning import thin

__version__ = "0.1.0"
__all__ = [
    "calibrate",
    "classify",
    "classify_ranges",
    "convert",
    "evaluate",
    "evaluate_all",
    "load_config",
    "open_stream",
    "render",
    "simulate",
    "stream",
    "thin",
    "transfer",
]

_HOME = {
    "calibrate": "prc_cli.calibration.calibrate",
    "convert": "prc_cli.conversion",
    "evaluate": "prc_cli.comparison",
    "evaluate_all": "prc_cli.comparison",
    "load_config": "prc_cli.config",
    "render": "prc_cli.rendering",
    "simulate": "prc_cli.simulated_files",
    "stream": "prc_cli.streaming",
    "thin": "prc_cli.thinning",
    "transfer": "prc_cli.label_transfer",
}


def __getattr__(name: str) -> Any:
    """Load a public function on first use (PEP 562)."""
    if name not in __all__:
        message = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(message)
    return getattr(import_module(_HOME.get(name, "prc_cli.pipeline")), name)
