"""Sections of a calibration's page, one file per section."""
