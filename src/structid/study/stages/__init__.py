"""Stages of a study, one file per stage. `study/stages/stage_list.py` lists them in order."""
