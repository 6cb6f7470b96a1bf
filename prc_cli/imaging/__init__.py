"""Pictures of ranges, labels and segments."""
