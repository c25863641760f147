"""Sweeps over heading noise and device: the grid, one cell, scores, pages."""
