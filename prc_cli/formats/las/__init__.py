"""LAS and LAZ: headers, points, compression, new files, and rewriting with changed classes."""
