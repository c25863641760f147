"""What `handcal prove --suite live --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, TypedDict

from handcal.results.kinds import Count, Floats, Kind, Texts


class LiveProof(TypedDict):
    """Simulated hands that `handcal live` leads, beside hands that it does not."""

    schema: Kind[Literal["handcal-sim/prove-live/1"]]
    hands: Annotated[Count, "How many."]
    worst: Annotated[_Worst, "The worst of biases and scale errors after the same time."]
    unguided_to_guided: Middle
    least_unguided_to_guided: Annotated[float, "Of any hand."]
    guided_to_planned: Middle
    seconds_to_enough: Annotated[Middle | None, "Until all was known as well as wanted."]
    enough: Annotated[Count, "Hands for which it was."]
    motions_asked: Annotated[Count, "In all."]
    motions_seen_done: Annotated[Count, "As the readings told."]
    errors: Annotated[_Errors, "Of the led hands' estimates."]
    seed: Count
    took_s: Annotated[float, "s."]
    trials: list[Trial]


class _Worst(TypedDict):
    guided: Middle
    unguided: Middle
    planned: Middle


_Middle = TypedDict(
    "_Middle",
    {"median": Annotated[float, "Of the hands."], "from": Annotated[float, "95 % interval."]},
)


class Middle(_Middle):
    """A median."""

    to: Annotated[float, "95 % interval."]


class _Errors(TypedDict):
    rms: Annotated[float, "In sigmas."]
    within_3_sigma: Annotated[float, "Their share."]
    of: Annotated[Count, "Estimates."]


class Trial(TypedDict):
    """One hand."""

    seed: Count
    guided: Annotated[_Guided, "Led for a minute."]
    unguided: Annotated[_Unguided, "Once about each axis, again and again."]
    planned: Annotated[_Unguided, "The best plan, asked once."]
    soon: Annotated[_Soon, "Led until all was known."]


class _Guided(TypedDict):
    worst: Annotated[float, "Of biases and scale errors, as times as uncertain as wanted."]
    errors: Annotated[Floats, "Of all estimates, in their sigmas."]
    names: Annotated[Texts, "Motions that were asked for."]
    seen: Annotated[Count, "That were seen to be done."]


class _Unguided(TypedDict):
    worst: Annotated[float, "Of biases and scale errors, as times as uncertain as wanted."]
    errors: Annotated[Floats, "Of all estimates, in their sigmas."]


class _Soon(TypedDict):
    seconds: Annotated[float, "Until all was known, s."]
    enough: bool
    names: Annotated[Texts, "Motions that were asked for."]
    seen: Annotated[Count, "That were seen to be done."]
