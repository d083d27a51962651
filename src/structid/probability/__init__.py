"""Prior distributions, parameter spaces, designs of experiments."""
