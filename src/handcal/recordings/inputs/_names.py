"""What the columns of a table are, by their names; columns.toml says which names there are."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

from handcal.did_you_mean import did_you_mean
from handcal.recordings.inputs._options import parse_unit, si
from handcal.recordings.streams import STREAMS

ASIDE = "-"  # of a column that is not read
_TOKENS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[^\W\d_]+")
_TERM = re.compile(r"([+-]?)\s*([A-Za-z ]+?)\s*(?=[+(-]|$)")
_CLOCK = ("time", "nanos", "date")
_PATHS = 6  # names that have to begin alike, for what they begin with to say nothing


@dataclass(frozen=True)
class Name:
    """One name of the table: terms, signed words without blanks, and the unit it implies."""

    text: str
    terms: tuple[tuple[float, str], ...]
    unit: str


@dataclass(frozen=True)
class Producer:
    """A program or device whose files say less than is known of them; as in columns.toml."""

    name: str
    columns: tuple[str, ...]
    units: Mapping[str, str]
    axes: Mapping[str, tuple[str, ...]]
    one_of: str
    header: str


@dataclass(frozen=True)
class Vocabulary:
    """columns.toml."""

    names: Mapping[str, tuple[Name, ...]]
    idle: frozenset[str]
    producers: tuple[Producer, ...]


@dataclass(frozen=True)
class Found:
    """Columns of a quantity: terms, a sign and the place of each axis; unit: that the file states,
    "" where it does not; name: as in the table."""

    terms: tuple[tuple[float, tuple[int, ...]], ...]
    unit: str
    name: str


@dataclass(frozen=True)
class Understood:
    """What the names say. found: by quantity; unused: names; missing: what has to be there and is
    not."""

    found: Mapping[str, Found]
    producer: Producer | None
    one_of: int | None
    unused: tuple[str, ...]
    missing: tuple[str, ...]


def vocabulary() -> Vocabulary:
    """The table of names."""
    text = files("handcal.recordings.inputs").joinpath("columns.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)
    called = {row.name: row.csv for row in STREAMS.values() if row.csv} | table["columns"]
    names = {q: tuple(_name(q, text) for text in some) for q, some in called.items()}
    producers = tuple(
        Producer(p["name"], tuple(p["columns"]), p.get("units", {}),
                 {sensor: tuple(axes.split(",")) for sensor, axes in p.get("axes", {}).items()},
                 p.get("one_of", ""), p["header"]) for p in table["producer"]
    )  # fmt: skip
    return Vocabulary(names, frozenset(table["words"]["idle"]), producers)


def _name(quantity: str, text: str) -> Name:
    words, _, unit = text.partition("(")
    terms = tuple(
        (-1.0 if sign == "-" else 1.0, word.replace(" ", "").lower())
        for sign, word in _TERM.findall(words.strip())
    )
    return Name(text, terms, parse_unit(quantity, unit.rstrip(")")) or "" if unit else "")


def axes_of(quantity: str) -> tuple[str, ...]:
    """What follows the name in a header: nothing where there is one column."""
    return ("",) if _is_single(quantity) else ("x", "y", "z")


def _is_single(quantity: str) -> bool:
    row = STREAMS.get(quantity)
    return quantity in _CLOCK or (row is not None and len(row.columns) == 1)


def understood(names: Sequence[str], units: Sequence[str], needed: Sequence[str]) -> Understood:
    """What columns of such names are.

    units: of a second header, as many, or none; needed: quantities that have to be there.
    """
    known = vocabulary()
    whole = ["".join(_tokens(name)) for name in names]
    written = {name.strip() for name in names} | {_split_unit(name)[0].strip() for name in names}
    producer = next((p for p in known.producers if set(p.columns) <= written), None)
    places: dict[str, dict[str, tuple[int, str]]] = {}  # by word and axis
    shared = _shared([_tokens(name) for name in names])
    for place, name in enumerate(names):
        if name.strip() in ("", ASIDE):
            continue
        stated = units[place] if place < len(units) else ""
        if (read := _read(name, stated, known, shared)) is not None:
            word, axis, unit = read
            places.setdefault(word, {}).setdefault(axis, (place, unit))
    computed = {"roll", "pitch"} <= {w.removesuffix("deg").removesuffix("rad") for w in whole}
    found, missing = {}, []
    for quantity, some in known.names.items():
        if quantity == "heading" and computed:  # an attitude that somebody's filter has made
            continue
        one = next((n for n in some if _complete(quantity, n, places)), None)
        if one is not None:
            found[quantity] = _found(quantity, one, places, producer)
        else:
            missing += _lacking(quantity, some, places, quantity in needed)
    used = {at for one in found.values() for _, some in one.terms for at in some}
    one_of = list(names).index(producer.one_of) if producer and producer.one_of else None
    unused = [n for k, n in enumerate(names) if k not in used and n.strip() not in ("", ASIDE)]
    return Understood(found, producer, one_of, tuple(unused), tuple(missing))


def _tokens(name: str) -> list[str]:
    """``userAccelerationX`` is user, acceleration, x."""
    return [token.lower() for token in _TOKENS.findall(_split_unit(name)[0])]


def _split_unit(name: str) -> tuple[str, str]:
    """A name and the unit in brackets behind it; an axis in brackets stays with the name."""
    match = re.fullmatch(r"\s*(.*?)\s*[(\[](.*)[)\]]\s*", name)
    if match is None:
        return name, ""
    return (f"{match[1]} {match[2]}", "") if match[2].lower() in "xyz0123" else (match[1], match[2])


def _shared(all_tokens: Sequence[Sequence[str]]) -> int:
    """How many first words the long names have in common, such as a device's."""
    named = [tokens for tokens in all_tokens if len(tokens) > 2]
    if len(named) < _PATHS:
        return 0
    count = 0
    while all(len(t) > count + 1 and t[count] == named[0][count] for t in named):
        count += 1
    return count


def _read(name: str, stated: str, known: Vocabulary, shared: int) -> tuple[str, str, str] | None:
    """Word, axis and unit of one name; None where it is none that is known."""
    bracketed = _split_unit(name)[1]
    tokens = _tokens(name)
    tokens = tokens[shared:] if len(tokens) > 2 else tokens
    plain = [token for token in tokens if token not in known.idle]
    for some in (tokens, plain, [token for token in plain if not token.isdigit()]):
        for axis, rest in _axis_apart(some):
            for count in range(len(rest), 0, -1):
                word, tail = "".join(rest[:count]), "".join(rest[count:])
                for quantity in _of_word(word, known, bool(axis)):
                    if not tail:
                        return word, axis, bracketed or stated
                    if unit := parse_unit(quantity, tail):
                        return word, axis, bracketed or stated or unit
    return None


def _axis_apart(tokens: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Ways to take an axis out of the words of a name, and none at all; 0 to 2 are x to z."""
    yield "", list(tokens)
    for k in reversed(range(len(tokens))):
        others = [*tokens[:k], *tokens[k + 1 :]]
        if tokens[k] in ("x", "y", "z"):
            yield tokens[k], others
        if tokens[k] in ("0", "1", "2"):
            yield "xyz"[int(tokens[k])], others
    for k, token in enumerate(tokens):
        if len(token) > 1:
            for axis, left in ((token[-1], token[:-1]), (token[0], token[1:])):
                if axis in "xyz":
                    yield axis, [*tokens[:k], left, *tokens[k + 1 :]]


def _of_word(word: str, known: Vocabulary, axis: bool) -> list[str]:
    """Quantities that a word may be of, of those with axes or without."""
    return [
        quantity
        for quantity, some in known.names.items()
        if _is_single(quantity) != axis
        and any(word == term for name in some for _, term in name.terms)
    ]


def _complete(quantity: str, name: Name, places: Mapping[str, Mapping[str, object]]) -> bool:
    return all(axis in places.get(word, {}) for _, word in name.terms for axis in axes_of(quantity))


def _found(
    quantity: str,
    name: Name,
    places: Mapping[str, Mapping[str, tuple[int, str]]],
    producer: Producer | None,
) -> Found:
    """The columns of a name that is complete; a unit that differs from axis to axis is none."""
    terms, units = [], []
    for sign, word in name.terms:
        cells = [places[word][axis] for axis in axes_of(quantity)]
        terms.append((sign, tuple(place for place, _ in cells)))
        units += [unit for _, unit in cells]
    known = {parse_unit(quantity, unit) or unit if si(quantity) else "" for unit in units}
    unit = next(iter(known)) if len(known) == 1 else " and ".join(sorted(known))
    implied = name.unit or (producer.units.get(quantity, "") if producer else "")
    return Found(tuple(terms), unit or implied, name.text)


def _lacking(
    quantity: str, some: Sequence[Name], places: Mapping[str, Mapping[str, object]], needed: bool
) -> list[str]:
    """What is missing of a quantity: all of what has to be there, the rest of what is begun."""
    axes = axes_of(quantity)
    begun = [
        [axis for axis in axes if any(axis not in places.get(word, {}) for _, word in name.terms)]
        for name in some
        if any(word in places for _, word in name.terms)
    ]
    if not needed and not (begun and quantity in STREAMS):
        return []
    return [f"{quantity} {axis}".strip() for axis in min(begun, key=len, default=axes)]


def unknown_columns(columns: Sequence[str]) -> list[str]:
    """A sentence for each name of ``--columns`` that is none."""
    known = vocabulary()
    usual = ["t", *(f"{s}{axis}" for s in "gam" for axis in "xyz"), "temp", "heading"]
    return [
        f"--columns: {name!r} is no column.{did_you_mean(name, usual)} They are "
        f"{', '.join(usual)}, each also with its unit (ax_g), and - for one to leave aside"
        for name in columns
        if name not in ("", ASIDE) and _read(name, "", known, 0) is None
    ]
