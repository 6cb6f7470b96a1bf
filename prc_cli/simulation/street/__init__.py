"""Streets: an endless scene of bodies to drive through."""
