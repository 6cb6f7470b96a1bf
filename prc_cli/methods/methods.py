"""The table of methods: the only place outside a method's folder that names it.

Importing this loads the parameters of all methods, and no compiled loop. Another package adds a
method by an entry point of the group ``prc_cli.methods`` that names a
:class:`~prc_cli.methods.base.Method`; nothing of this package has to be touched.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from pydantic import Field, create_model

from prc_cli.core.config import Params
from prc_cli.core.plugins import load_plugins
from prc_cli.methods.base import Method
from prc_cli.methods.fused.pipeline import FusedParams
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.rings.pipeline import RingsParams
from prc_cli.methods.sequential_angle.pipeline import SequentialAngleParams

ENTRY_POINTS = "prc_cli.methods"
"""Group of the entry points of other packages."""
_BUILT_IN = (
    Method("prc", PrcParams, "PRC (Lehtola et al. 2019)"),
    Method(
        "sequential-angle",
        SequentialAngleParams,
        "sequential-angle (Stamos et al. 2012)",
        mapping="street_scan",
    ),
    Method("fused", FusedParams, "fused", mapping="street"),
    Method("rings", RingsParams, "rings of spinning scanners", mapping="street"),
)
_OF_OTHERS: tuple[Method, ...] = load_plugins(ENTRY_POINTS)
METHOD_TABLE = {method.name: method for method in (*_BUILT_IN, *_OF_OTHERS)}
"""All methods by name, those of other packages last."""

PRESETS_OF_OTHERS: dict[str, Path] = {
    path.stem.replace("_", "-"): path for method in _OF_OTHERS for path in method.presets
}
"""Files of the presets of other packages."""


def _field(method: Method) -> Any:
    return Field(default_factory=method.params, description=method.description)


def table_of(method: str) -> str:
    """Return the name of a method's table in the configuration.

    >>> table_of("sequential-angle")
    'sequential_angle'
    """
    return method.replace("-", "_")


class _BuiltInTables(Params):
    """The parameters of all methods."""

    prc: PrcParams = _field(_BUILT_IN[0])
    sequential_angle: SequentialAngleParams = _field(_BUILT_IN[1])
    fused: FusedParams = _field(_BUILT_IN[2])
    rings: RingsParams = _field(_BUILT_IN[3])


if TYPE_CHECKING:
    MethodName: TypeAlias = Literal["prc", "sequential-angle", "fused", "rings"]
    MethodTables: TypeAlias = _BuiltInTables
else:
    MethodName = Literal[tuple(METHOD_TABLE)]
    MethodTables = create_model(
        "MethodTables",
        __base__=_BuiltInTables,
        **{table_of(method.name): (method.params, _field(method)) for method in _OF_OTHERS},
    )

METHODS: tuple[MethodName, ...] = tuple(METHOD_TABLE)  # type: ignore[arg-type]
"""Names of the methods; a method's table in the configuration has underscores for hyphens."""
