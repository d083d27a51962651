"""Commands, one file each. `commands/command_list.py` says their order. They own the screen; nothing below them prints."""
