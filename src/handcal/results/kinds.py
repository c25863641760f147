"""How the types of results say what JSON Schema says. Beside a type, in ``Annotated``: a first text
is the description, a second one when the key is there, and pairs are keywords of JSON Schema."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

T = TypeVar("T")

AT_LEAST_0 = (("minimum", 0),)
Later = Annotated[T, (("required_key", False),)]  # a key that results of older programs lack
Kind = Annotated[T, "Which kind of result, and of which edition."]
Version = Later[Annotated[str, "Of the program that wrote it."]]

Number = float | None  # null stands for a number that there is not
Count = Annotated[int, AT_LEAST_0]
Positive = Annotated[float, AT_LEAST_0]
Fraction = Annotated[float, (("minimum", 0), ("maximum", 1))]
Texts = list[str]
Floats = list[float]
Empty = Annotated[dict[str, Any], (("maxProperties", 0),)]

Some = Annotated[list[T], (("minItems", 1),)]
Two = Annotated[list[T], (("minItems", 2), ("maxItems", 2))]
Three = Annotated[list[T], (("minItems", 3), ("maxItems", 3))]
Four = Annotated[list[T], (("minItems", 4), ("maxItems", 4))]
Six = Annotated[list[T], (("minItems", 6), ("maxItems", 6))]
Vector = Three[float]
