"""The stream from a registered cloud: lines, columns and ranges from coordinates and times.

A rotating scanner turns evenly, so the bearing of a shot in its own scan plane is known from its
time. Every scan line is then a resection: known bearings to known points, an unknown station.

- :mod:`.rotation` finds how fast the beam turns.
- :mod:`.resection` finds the station and the frame of single lines, in closed form.
- :mod:`.path` joins them into one smooth path.
- :mod:`.scan` puts every point into its line and column.
- :mod:`.source` reads a cloud this way.
"""
