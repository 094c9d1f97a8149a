"""Checks by what was not used, or is made up: left-out planes, a second solver, simulated studies."""
