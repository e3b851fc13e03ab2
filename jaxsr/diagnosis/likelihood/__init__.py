"""The likelihood of recordings under an edit of the model, with forces that nobody knows.

`local` linearises the simulator's own step map along a path; `kalman` adds a random force to every
equation of motion, turns residuals and derivatives into independent innovations and smooths the
path; `evidence` weighs sets of constants on them, `estimate` iterates to the mode, `noise` and
`steps` settle sensors and integration; `workspace`, `hypotheses`, `loop` and `posterior` search.
No command decides by it yet: it runs in shadow, in `benchmarks.evidence`.
"""
