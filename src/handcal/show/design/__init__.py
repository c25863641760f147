"""Designs of poses and motions as words, pictures and pages."""
