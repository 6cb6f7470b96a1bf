"""Shared by all layers: errors, class codes, stream types, configuration machinery, atomic files, threads."""
