"""The table of methods: the only place outside a method's folder that names it.

Importing this loads the parameters of all methods, and no compiled loop.
"""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

from pydantic import Field

from prc_cli.core.config import Params
from prc_cli.methods.fused.pipeline import FusedParams
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.rings.pipeline import RingsParams
from prc_cli.methods.sequential_angle.pipeline import SequentialAngleParams

MethodName: TypeAlias = Literal["prc", "sequential-angle", "fused", "rings"]
METHODS: tuple[MethodName, ...] = get_args(MethodName)
"""Names of the methods; a method's table in the configuration has underscores for hyphens."""


class MethodTables(Params):
    """The parameters of all methods."""

    prc: PrcParams = Field(default_factory=PrcParams, description="PRC (Lehtola et al. 2019)")
    sequential_angle: SequentialAngleParams = Field(
        default_factory=SequentialAngleParams, description="sequential-angle (Stamos et al. 2012)"
    )
    fused: FusedParams = Field(default_factory=FusedParams, description="fused")
    rings: RingsParams = Field(
        default_factory=RingsParams, description="rings of spinning scanners"
    )


def table_of(method: MethodName) -> str:
    """Return the name of a method's table in the configuration.

    >>> table_of("sequential-angle")
    'sequential_angle'
    """
    return method.replace("-", "_")
