"""Stages of a study, one file each. `study/stages/stage_list.py` says their order."""
