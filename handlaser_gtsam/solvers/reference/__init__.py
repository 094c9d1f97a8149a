"""An independent solution with SciPy, by equations of its own, that can contradict all others."""
