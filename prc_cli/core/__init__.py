"""Shared by all layers: errors, class codes, stream types, configuration, files, threads."""
