"""Text files of one record a row, plain or compressed."""
