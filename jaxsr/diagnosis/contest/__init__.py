"""The contest: sets of candidates estimated in free run, compared on blocks held back."""
