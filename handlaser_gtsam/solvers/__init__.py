"""Solvers: Levenberg-Marquardt on the graph, the paper's reduction in NumPy, SciPy as reference."""
