"""The likelihood of recordings under an edit of the model, with forces that nobody knows.

`local` linearises the simulator's own step map along a path; `kalman` adds a random force to every
equation of motion, turns residuals and derivatives into independent innovations and smooths the
path; `evidence` weighs sets of constants on them, `estimate` iterates to the mode, `noise`,
`steps` and `switched` settle sensors and integration. `course` is the motion that re-calibration
follows, hidden states included; `offered` and `support` make candidates of it, `table` their
columns about one path, `proposals` sets of them; `hypotheses`, `loop` and `posterior` search.
"""
