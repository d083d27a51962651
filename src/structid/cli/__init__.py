"""The command line: commands, screen output, exit codes."""
