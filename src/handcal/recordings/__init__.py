"""Recordings as they come and go: streams, formats, rests, MCAP."""
