"""Our own combination of both papers, working in the scan plane.

Needs only range, angle and time.
"""
