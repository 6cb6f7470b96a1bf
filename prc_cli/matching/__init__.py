"""Which record of one side belongs to which of another: keys, the merge join, pairs of files."""
