"""What every layer may speak: errors, class codes, the stream types, configuration machinery, safe files."""
