"""An effect of a heading and of a magnetometer is called after the one that was recorded."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from fake_explanation import fake_explanation

from handcal.effects import catalogue
from handcal.explain.stream_words import of_hypothesis, of_missing


@pytest.mark.parametrize("effect", ["heading_delay", "heading_drift", "heading_soft_iron"])
@pytest.mark.parametrize("kinds", [("magnetometer",), ("heading",), ("heading", "magnetometer")])
def test_it_is_the_magnetometers_where_there_is_no_heading(effect, kinds):
    e, known = fake_explanation("explained", recordings=1), catalogue()[effect]
    m = replace(e.missing[0], effect=effect, title=known.title, story=known.story)
    h = replace(e.hypotheses[0], effect=effect, title=known.title)
    cases = [SimpleNamespace(kinds=("zero_velocity", *kinds))]
    renamed = kinds == ("magnetometer",) and effect != "heading_soft_iron"
    for said in (of_missing(m, cases), of_hypothesis(h, cases)):
        assert said.effect == effect
        text = f"{said.title} {getattr(said, 'story', '')}".lower()
        assert ("magnetometer" in text) == renamed
        assert ("heading" in text) != renamed
