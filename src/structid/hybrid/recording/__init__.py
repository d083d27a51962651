"""Recordings and result files of hybrid tests."""
