"""What the sections of a report are made from."""
