"""Sections of a calibration's page, one file each."""
