"""Builds the stream from a file.

Finds scan lines, columns and ranges in records, in the same way for every format.
"""
