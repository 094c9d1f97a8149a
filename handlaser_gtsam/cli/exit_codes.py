"""The exit codes of the command; 0 is good."""

BAD_INPUT = 2
"""Input, options or files that were refused: the code of shells for a wrong usage."""
UNDETERMINED = 3
"""No calibration: the recording does not determine what was asked, or no solver converged."""
NOT_USABLE = 4
"""A calibration that is not to be used."""
INTERRUPTED = 130
"""Stopped by Ctrl-C: 128 and the number of the signal, as in a shell."""
