"""The structure of a NARX: terms, memories, the recursion."""
