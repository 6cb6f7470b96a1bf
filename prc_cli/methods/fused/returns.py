"""Labels of further returns: that of a shot at a similar range; behind a leaf, vegetation."""

from __future__ import annotations

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, I32, U8
from prc_cli.methods.returns import label_extra_returns


def label_further_returns(range_m: F32, labels: U8, line: I32, column: I32, range_m_extra: F32, limit_m: float) -> U8:
    """Label the returns of a shot other than its main one.

    Light that passes a leaf meets other leaves, which may be isolated; such returns are vegetation, not noise.

    Returns (n,) uint8.

    >>> import numpy as np
    >>> image = np.array([[6.0, 6.1, 20.0]], dtype=np.float32)
    >>> labels = np.array([[Label.VEGETATION, Label.VEGETATION, Label.BUILDING]], dtype=np.uint8)
    >>> own = np.zeros(2, np.int32), np.array([0, 2], np.int32), np.array([9.0, 30.0], np.float32)
    >>> [Label(label).name for label in label_further_returns(image, labels, *own, 0.3)]
    ['VEGETATION', 'NOISE']
    """
    found = label_extra_returns(range_m, labels, line, column, range_m_extra, limit_m, limit_m)
    found[(labels[line, column] == Label.VEGETATION) & (found == Label.NOISE)] = Label.VEGETATION
    return found
