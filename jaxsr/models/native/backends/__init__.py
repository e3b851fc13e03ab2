"""Simulators in the worker's process: scripts that import nothing of the package."""
