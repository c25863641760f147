"""The dashboard of a session: what it is told can be seen afterwards."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rerun")

from handcal.show.dashboard.session import board
from handcal.types import Innovations, Parameter

PICTURES = os.environ.get("HANDCAL_PICTURES")


def chunks(path: Path) -> dict[str, int]:
    """Rows of each entity in a file."""
    from rerun.chunk import RrdReader

    rows: dict[str, int] = {}
    for chunk in RrdReader(str(path)).stream().to_chunks():
        rows[str(chunk.entity_path)] = rows.get(str(chunk.entity_path), 0) + chunk.num_rows
    return rows


def known(seconds: float, *effects: str) -> Any:
    at = np.arange(0.5, seconds, 0.5)
    one = Innovations(at, np.zeros((len(at), 3)), np.ones((len(at), 3)), np.full(len(at), 3.0), 0,
                      "m", ("position_x", "position_y", "position_z"))  # fmt: skip
    parameters = tuple(Parameter(e, a, 0.0, 1e-3, "1", 1e-2, None) for e in effects for a in "xyz")
    return parameters, {"fixed_position": one}


def test_a_session_can_be_seen_afterwards(tmp_path):
    """Only what is new of the innovations is drawn; effects may come up on the way."""
    path = tmp_path / "x.rrd"
    picture = {"from": np.eye(3).ravel().tolist(), "axis": [0, 0, 1], "degrees": 360.0,
               "seconds": 5.0}  # fmt: skip
    turn = {"say": "Turn it", "done": 0.5, "hint": "", "picture": picture}
    with board(show=False, rrd=path) as shown:
        for second in range(10):
            t = second + np.arange(100) / 100
            shown.readings(t, np.zeros((100, 3)), np.zeros((100, 3)), np.eye(3))
            shown.guidance(float(t[-1]), {"turn": turn, "brought": ""})
        for end, effects in ((6.0, ("gyro_scale",)), (10.0, ("gyro_scale", "accel_scale"))):
            parameters, innovations = known(end, *effects)
            shown.estimates(end, parameters)
            shown.updates(innovations)
        one = innovations["fixed_position"]
        wild = replace(one, t=one.t[:1] + 11.0, residual=one.residual[:1], nis=one.nis[:1],
                       sigma=50.0 * one.sigma[:1])  # fmt: skip
        shown.updates({"fixed_position": wild})  # (it would make the others invisible)
        shown.hypotheses(10.0, {"gyro_scale": 12.0})
    rows = chunks(path)
    assert rows["/imu/gyro"] == 10 * 50 + 1  # (50 a second, and how they are drawn)
    assert rows["/device"] == 10
    assert rows["/innovation/fixed_position/residual"] == 19 + 1
    assert rows["/parameters/gyro_scale/estimate"] == 2 + 1
    assert rows["/parameters/accel_scale/estimate"] == 1 + 1
    assert rows["/hypotheses/gyro_scale"] == 1 + 1
    assert rows["/guidance"] == 1 + 1  # (it stayed the same)
    assert rows["/asked"] >= 10


@pytest.mark.prove
def test_a_led_session_as_it_is_shown(tmp_path):
    """A led hand's recording fed in real time into a viewer without a window, and a picture."""
    import handcal
    from handcal.live.ending import Wanted
    from handcal.live.guide import ENOUGH
    from handcal.live.recorder import opened
    from handcal.live.run import fed
    from handcal.live.session import Session
    from handcal.live.turns import CHOICE, FIRST
    from handcal.recordings.export import write_mcap
    from handcal.show.dashboard import session as module
    from handcal_sim.prove.live import Hand

    names = ("once about z, standing, and back", "half round about y, rest, and back",
             "once about y and back", "on its left edge, rest, and back",
             "once about x and back")  # fmt: skip
    turns = [*FIRST.motion.turns, *(t for n in names for a in CHOICE if a.name == n
                                    for t in a.motion.turns)]  # fmt: skip
    write_mcap(Hand(21).recorded(turns)[1], tmp_path / "x.mcap")
    recording = handcal.load(tmp_path / "x.mcap")
    shots: list[Any] = []
    said: list[str] = []

    class Looked(module.SessionBoard):
        def guidance(self, t: float, told: Any) -> None:
            super().guidance(t, told)
            if t > recording.duration_s - 6.0 and not shots and PICTURES:
                shots.append(_shot(urls[0]))

    urls: list[str] = []
    own = module.viewer

    def noted(**options: Any) -> Any:
        made = own(**options)

        class Noted:
            def __enter__(self) -> Any:
                shown = made.__enter__()
                urls.append(shown.url)
                return shown

            def __exit__(self, *error: Any) -> Any:
                return made.__exit__(*error)

        return Noted()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "SessionBoard", Looked)
        patch.setattr(module, "viewer", noted)
        extra = ("--headless", "--window-size", "1600x900")
        with module.board(show=True, rrd=tmp_path / "x.rrd", extra=extra) as shown:
            ended = fed(Session(opened(tmp_path / "recording.mcap"), source="file"), recording, 1.0,
                        tmp_path, Wanted(), said.append, shown)  # fmt: skip
    assert "scale error" in ended.headline
    rows = chunks(tmp_path / "x.rrd")
    assert rows["/parameters/gyro_scale/estimate"] > 5
    assert rows["/hypotheses/gyro_scale"] >= 1
    assert ENOUGH in said  # (it was turned as would have been asked for)


def _shot(url: str) -> bool:
    from rerun.experimental import ViewerClient

    client, last = ViewerClient.connect(url), b""
    for _ in range(12):  # (until it has drawn everything)
        data = client.take_screenshot(max_size=1600)
        if data == last:
            break
        last = data
        time.sleep(0.4)
    Path(f"{PICTURES}/dashboard.png").write_bytes(last)
    return True
