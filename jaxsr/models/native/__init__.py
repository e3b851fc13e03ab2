"""Simulators that are no formulas: native or foreign code in a process of its own, asked by rows."""
