"""Stages of a study, one file each. `study/stage_list.py` says their order."""
