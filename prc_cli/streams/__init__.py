"""Builds the stream from a file.

Scan lines, columns and ranges from records, the same way for every format.
"""
