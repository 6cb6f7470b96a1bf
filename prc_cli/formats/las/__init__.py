"""LAS and LAZ: headers, points, compression, new files, and files that change in their classes alone."""
