"""Locate the mismatch, name the missing physics, model it, prove it."""
