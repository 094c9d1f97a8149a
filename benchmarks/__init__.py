"""Benchmarks: compare in one run, report ratios."""
