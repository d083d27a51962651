"""Prior knowledge: marginals, parameter spaces, designs of experiments."""
