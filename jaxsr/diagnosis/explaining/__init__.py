"""From a decision to verdict, findings, evidence and words."""
