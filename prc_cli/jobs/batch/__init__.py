"""Classifies an archive of files with many workers; a run that was killed continues."""
