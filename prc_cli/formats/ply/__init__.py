"""PLY: clouds of named properties, binary of both byte orders and text."""
