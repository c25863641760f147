"""What is known of a device beside the recording, and what the recording alone says."""

from __future__ import annotations

from typing import Annotated, TypedDict

from handcal.results.kinds import Floats, Number, Texts


class _Likelihood(TypedDict):
    parameters: Annotated[list[Texts], "Effect and name of each."]
    information: Annotated[list[list[Number]], "SI."]
    vector: Annotated[Floats, "SI."]


class KnownDevice(TypedDict):
    """The device file that said what was known before, and what it said."""

    path: Annotated[str, "Of the file."]
    name: Annotated[str, "Of the device."]
    sha256: Annotated[str, "Of the file, as it was read."]
    prior: Annotated[_Prior, "What was known of its parameters."]


class _Prior(TypedDict):
    parameters: Annotated[list[Texts], "Effect and name of each."]
    mean: Annotated[Floats, "SI."]
    covariance: Annotated[list[Floats], "SI."]


class KnownModel(TypedDict):
    """The file of priors that said what was known of devices of the model before, and what it
    said."""

    path: Annotated[str, "Of the file."]
    model: Annotated[str, "Which model of it."]
    recordings: Annotated[int, "Of how many it was learned."]
    devices: Annotated[int, "Of how many it was learned."]
    sha256: Annotated[str, "Of the file, as it was read."]
    prior: Annotated[_Prior, "What was known of its parameters."]


OwnLikelihood = Annotated[
    _Likelihood,
    "What the recording itself says of biases and effects, without any prior: log-likelihood "
    "`vector' x - x' information x / 2` of the parameters x, all else integrated out.",
    "with one recording",
]
