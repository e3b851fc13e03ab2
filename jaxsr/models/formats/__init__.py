"""Simulators that people have, each read into a formula model: one file a format."""
