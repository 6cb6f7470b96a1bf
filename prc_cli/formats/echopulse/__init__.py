"""Folders of pulses and echoes, one array a file (Stereopolis, LI3DS)."""
