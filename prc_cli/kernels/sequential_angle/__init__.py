"""Compiled loops of the sequential-angle classifier (Stamos et al. 2012)."""
