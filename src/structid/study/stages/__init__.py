"""Stages of a study, one file each. `study/stages/stage_list.py` gives their order."""
