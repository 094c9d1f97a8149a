"""Targets: where rays meet a plane or a sphere, and points that beams are aimed at; one file each.

A kind that labels state has its word in the `TARGETS` of `data/survey.py`; one that rays meet is in
`TARGETS` of `estimation/survey_rows.py` as well. A groove is two planes.
"""
