"""Assessment: what the draws are worth, what they predict, and whether to believe them."""
