"""Trajectories as files: text and SBET."""
