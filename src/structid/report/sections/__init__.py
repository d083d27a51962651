"""Sections of a report, one file each: title, words, tables, figures. `report/section_list.py` gives their order."""
