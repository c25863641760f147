"""Explanations and answers as a blind trial's tests need them."""

from handcal_sim.prove import trial as prove_trial
from handcal_sim.prove.suites import Answer


def parameter(effect, name, value, sigma=1.0):
    return {"effect": effect, "name": name, "value": value, "sigma": sigma, "unit": "1"}


def said(*missing, verdict=None, parameters=(), untellable=()):
    """missing: effects, or pairs of an effect and the values of its parameters."""
    rows = []
    for entry in missing:
        effect, values = entry if isinstance(entry, tuple) else (entry, {})
        rows.append({
            "effect": effect, "probability": 0.99, "log_evidence_gain": 20.0,
            "indistinguishable_from": [], "story": "",
            "parameters": [parameter(effect, name, value) for name, value in values.items()],
        })  # fmt: skip
    verdict = verdict or ("explained" if missing else "nothing_missing")
    return {"verdict": verdict, "missing": rows, "parameters": list(parameters), "unnamed": [],
            "untellable": [{"effect": e, "name": n} for e, n in untellable]}  # fmt: skip


def trial(suite, effects, document, baseline=None, further=None, **circumstances):
    answer = Answer(suite, "", effects, {}, baseline or {}, circumstances)
    return prove_trial.Trial("r0001", answer, document, 1.0, {}, further or {})
