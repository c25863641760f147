"""Errors against temperature (paper 004)."""
