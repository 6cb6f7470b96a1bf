"""Streets: an endless scene of bodies to drive through."""

from prc_cli.simulation.street.plan import StreetSceneParams
from prc_cli.simulation.street.scene import StreetScene

__all__ = ["StreetScene", "StreetSceneParams"]
