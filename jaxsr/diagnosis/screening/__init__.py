"""The weak view: every candidate screened where the sensors show the equations."""
