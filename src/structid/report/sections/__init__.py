"""Sections of a report, one file per section: title, paragraphs, tables, figures.

`report/section_list.py` lists the sections in order.
"""
