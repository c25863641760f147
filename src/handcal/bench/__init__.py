"""How fast: timings of the filter and of whole commands."""
