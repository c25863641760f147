"""Compiled numerics: rotations, strapdown mechanization, covariance, passes over recordings."""
