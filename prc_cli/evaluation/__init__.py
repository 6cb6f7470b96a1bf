"""Predicted against reference labels: class mapping, confusion matrix, scores and their reports."""
