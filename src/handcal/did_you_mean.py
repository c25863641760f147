"""What somebody who mistyped a word may have meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(word: str, known: Iterable[str], most: int = 2) -> str:
    """A question with a blank before it, to be added to a sentence; "" where no word is near."""
    near = difflib.get_close_matches(word, list(known), n=most)
    return f" Did you mean {' or '.join(near)}?" if near else ""
