"""Simulators that are no formulas: foreign code in a process of its own, asked by rows."""
