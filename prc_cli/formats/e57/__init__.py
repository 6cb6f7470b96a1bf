"""E57 (ASTM E2807), organised scans in a binary container."""
