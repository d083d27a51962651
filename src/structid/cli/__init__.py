"""The command line: commands, screen, exit codes."""
