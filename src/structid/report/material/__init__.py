"""The data from which the sections of a report are made."""
