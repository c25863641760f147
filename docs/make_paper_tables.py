"""Writes the tables of docs/paper-NNN.md: everything between the two marks is computed.

Run `make docs`, or this file alone; numbers of papers as arguments choose some of them.
"""

import sys
from pathlib import Path

from handcal.lab.papers.paper import computed, markdown, numbers

BEGIN, END = "<!-- computed: docs/make_paper_tables.py -->", "<!-- end of what is computed -->"
DOCS = Path(__file__).resolve().parent


def page(text: str, number: str) -> str:
    """The page with its tables as the code computes them now."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    tables = markdown(computed(number).tables())
    return f"{before}{BEGIN}\n\n{tables}\n{END}{after}"


if __name__ == "__main__":
    for number in sys.argv[1:] or numbers():
        path = DOCS / f"paper-{number}.md"
        path.write_text(page(path.read_text(encoding="utf-8"), number), encoding="utf-8")
        print(path.name)
