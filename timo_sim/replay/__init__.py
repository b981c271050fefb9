"""Recorded runs again: the same to the last bit, or with something changed."""
