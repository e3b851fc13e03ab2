"""Forces that free runs locate: pushes, waves, resonances, springs."""
