"""Builds the stream from a file: scan lines, columns and ranges from records, the same way for every format."""
