"""Archive files to blocks of the stream."""
