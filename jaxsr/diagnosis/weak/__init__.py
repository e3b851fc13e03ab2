"""The weak view: equations that can be read off the sensors, seen through test functions."""
