"""One classifier out of both papers and what the scan plane tells beside them; needs range, angle and time alone."""
