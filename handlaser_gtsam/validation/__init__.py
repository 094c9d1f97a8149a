"""Checks by what was not used: planes left out, other recordings, a second solver, resampling."""
