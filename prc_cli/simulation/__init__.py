"""Simulated scans with a reference label for every shot; the data that comes with the package."""
