"""The likelihood of recordings under an edit of the model, with forces that nobody knows.

`local` linearises the simulator's own step map along a path, `latent` adds a random force to every
equation of motion, `kalman` turns residuals and derivatives into independent innovations and
smooths the path, `evidence` weighs sets of constants on them, `estimate` iterates to the mode.
"""
