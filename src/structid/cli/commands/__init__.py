"""Commands, one file per command. `cli/commands/command_list.py` lists the commands in order."""
