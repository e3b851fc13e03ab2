"""How far a diagnosis carries beyond what it was settled on: planted cases in groups.

Systems, sensing and mechanisms come in groups. What the rules and numbers of the tool were
settled on stands in `settled_on.json`; scores are given inside and outside of it, side by side.
Nothing here goes through `jaxsr` but the answers: motions are integrated by SciPy from laws
written anew.
"""
