"""The search for sets of mechanisms: contenders, growth, exchange, regrouping, the choice."""
