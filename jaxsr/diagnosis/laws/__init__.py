"""Laws without a name, which the evolution writes."""
