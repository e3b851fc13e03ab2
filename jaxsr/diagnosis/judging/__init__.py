"""Judging entries: noise, physics, criteria, detection, intervals."""
