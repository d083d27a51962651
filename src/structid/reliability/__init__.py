"""How often a response passes a limit, over the parameters of a model and over its posterior; what its peaks depend on."""
