"""Cases of a parametrised test that only ``make prove`` runs."""

from __future__ import annotations

from typing import Any

import pytest


def proved(*cases: Any) -> list[Any]:
    """Each marked; a tuple holds the values of several parameters."""
    each = (c if isinstance(c, tuple) else (c,) for c in cases)
    return [pytest.param(*values, marks=pytest.mark.prove) for values in each]
