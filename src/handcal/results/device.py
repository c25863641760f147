"""What `handcal device show --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Floats, Kind, Number, Texts, Version


class DeviceShown(TypedDict):
    """What is known of a device on a day."""

    schema: Kind[Literal["handcal/device-shown/1"]]
    version: NotRequired[Version]
    name: Annotated[str, "Of the device."]
    sha256: Annotated[str, "Of the device file."]
    date: Annotated[str, "The day of which it is said."]
    sessions: Annotated[list[Session], "What the file holds."]
    parameters: Annotated[list[Known], "What all of them say together."]
    covariance: Annotated[list[Floats], "Of the parameters, in their order and units."]
    disagreements: Annotated[list[Disagreement], "Sessions that say what cannot both be."]


class Session(TypedDict):
    """One result that was added."""

    recorded: Annotated[str, "When."]
    temperature_degC: Annotated[Number, "How warm it was."]
    recordings: Annotated[Texts, "Their files."]
    parameters: Annotated[Count, "How many it told."]


class Known(TypedDict):
    """A parameter as it is known on that day."""

    effect: Annotated[str, "Id of the effect."]
    name: Annotated[str, "Of the parameter."]
    value: Annotated[float, "In its unit."]
    sigma: Annotated[float, "Standard deviation of the value."]
    unit: Annotated[str, "SI."]


class Disagreement(TypedDict):
    """Two sessions that differ."""

    sessions: Annotated[list[int], "Their numbers."]
    effect: Annotated[str, "In which effect."]
    chi2: Annotated[float, "Of the difference."]
    dof: Annotated[int, "Its degrees of freedom."]
    chance: Annotated[float, "Of so large a one by noise."]
