"""Blocks of the stream in, one label per shot out; a folder for each method."""
