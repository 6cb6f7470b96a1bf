"""Streets: an endless scene of bodies to drive through, and the small street that ``prc demo`` still uses."""

from prc_cli.simulation.street.old_street import LANE_M, StreetParams, StreetScan, _rays, simulate_street
from prc_cli.simulation.street.params import StreetSceneParams
from prc_cli.simulation.street.scene import StreetScene

__all__ = ["LANE_M", "StreetParams", "StreetScan", "StreetScene", "StreetSceneParams", "_rays", "simulate_street"]
