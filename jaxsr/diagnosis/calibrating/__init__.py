"""Re-calibration in free run: how far ahead, from which starts."""
