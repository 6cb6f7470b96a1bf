"""Our own combination of both papers, working in the scan plane; needs only range, angle and time."""
