"""Sections of the page of a hybrid test programme, one file each."""
