"""The structure of a NARX: terms, memories and the recursion."""
