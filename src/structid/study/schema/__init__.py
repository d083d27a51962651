"""Schema of study files: keys with units and defaults, and messages for errors."""
