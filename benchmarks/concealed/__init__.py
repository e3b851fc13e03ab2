"""Planted cases of missing physics: sealed, run and scored by three separate programs.

``python -m benchmarks.concealed.seal`` draws cases from a seed and locks the truth away,
``python -m benchmarks.concealed.run`` diagnoses them, ``python -m benchmarks.concealed.score``
alone opens the truth.
"""
