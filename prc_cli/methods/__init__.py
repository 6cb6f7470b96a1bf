"""Classifiers: blocks of scan lines in, one label per shot out; one folder per method."""
