"""PCD, the clouds of the Point Cloud Library: text, binary and compressed."""
