"""Laboratory results as words, JSON and pages."""
