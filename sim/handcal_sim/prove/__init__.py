"""Blind trials of ``explain``: drawn, written, explained by other processes, scored."""
