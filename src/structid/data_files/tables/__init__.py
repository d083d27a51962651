"""Tables of columns: text of loggers, and what other formats hold as columns."""
