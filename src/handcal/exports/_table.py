"""The rows of the tables: what was estimated, with its sigma and unit."""

from __future__ import annotations

from handcal.exports import Contents

HEAD = ("effect", "parameter", "value", "sigma", "unit", "observable", "recording")


def rows(contents: Contents) -> list[tuple[str, ...]]:
    """As ``HEAD``; numbers with all their digits, nothing where the result has none; the recording
    where a parameter is that of one of several."""
    out = []
    for p in contents.parameters:
        numbers = ["" if p.get(k) is None else repr(float(p[k])) for k in ("value", "sigma")]
        seen = {True: "yes", False: "no"}.get(p.get("observable", None), "")
        of = str(p.get("recording", ""))
        out.append((str(p["effect"]), str(p["name"]), *numbers, str(p.get("unit", "")), seen, of))
    return out


def short(value: str, sigma: str) -> tuple[str, str]:
    """Value and sigma to the second digit of sigma."""
    if not value or not sigma or float(sigma) <= 0.0:
        return value, sigma
    shown = f"{float(sigma):.1e}"
    digits = max(0, 1 - int(shown.split("e")[1]))
    return f"{float(value):.{digits}f}", f"{float(sigma):.{digits}f}"
