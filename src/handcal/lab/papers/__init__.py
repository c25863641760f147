"""The papers, computed again: one file a paper."""
