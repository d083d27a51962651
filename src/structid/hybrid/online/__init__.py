"""Parameters and models that are updated while a hybrid test runs."""
