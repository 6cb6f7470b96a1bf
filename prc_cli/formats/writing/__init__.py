"""What all writers share; :mod:`prc_cli.formats.outputs` chooses the writer of an output."""
