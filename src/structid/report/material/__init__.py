"""The data for the sections of a report."""
