"""An archive becomes a stream: records are put into scan lines, columns and ranges, the same way for every format."""
