"""Stages of a study, one file per stage. `study/stages/stage_list.py` lists the stages in order."""
