"""Targets: what rays meet, and where; one file each.

A kind that labels state has its word in `data/survey.py`, and its class in `estimation/survey_rows.py`.
"""
