"""Which poses and motions would tell most, by the information matrix."""
