"""Free runs: sets of mechanisms estimated by multiple shooting."""
