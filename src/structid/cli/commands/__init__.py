"""Commands, one file each. `cli/commands/command_list.py` gives their order."""
