"""An archive of files, classified by many workers, that can be killed at any moment and goes on where it was."""
