"""Compiled loops of the fused classifier."""
