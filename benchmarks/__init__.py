"""Benchmarks: compare in one run, report ratios."""

import os

# One thread a process, as the command has it. NumPy reads this when it is imported.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
