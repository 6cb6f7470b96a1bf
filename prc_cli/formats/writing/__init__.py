"""Shared parts of writers: atomic outputs, their options and their run record."""
