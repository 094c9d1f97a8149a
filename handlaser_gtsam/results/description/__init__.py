"""A calibration in facts, sentences and tables, made once: every view renders these."""
