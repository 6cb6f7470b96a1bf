"""What compiled loops and their plain twins are given, by name: one module of ``NamedTuple`` classes per method."""
