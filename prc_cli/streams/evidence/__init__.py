"""Evidence: what a stream shows of itself, and whether it is what it is said to be."""
