"""Results and explanations in the Rerun viewer. The only package that imports rerun.

Of a result, saved or streamed alike: ``/device`` (how the phone is turned, in 3-D; not
where it is), ``/heading``, ``/parameters/EFFECT``, ``/innovation/KIND``, ``/nis/KIND``,
``/imu`` and ``/summary``; timeline ``time``, seconds since the start of the recording.

Of an explanation: ``/verdict``, ``/hypotheses/EFFECT`` and, for each recording from
``/recording_1`` on, ``simulated/CHANNEL``, ``difference/CHANNEL``, ``shortfall/CHANNEL``
and ``evidence/EFFECT``.

Of a set of poses: ``/all/NUMBER``, ``/one`` and ``/instruction`` by timeline ``pose``.
"""

from handcal.show.dashboard.common import APPLICATION, TIMELINE, file_sink
from handcal.show.dashboard.explanations import (
    explanation_blueprint,
    log_explanation,
    save_explanation_rrd,
)
from handcal.show.dashboard.poses import save_poses_rrd
from handcal.show.dashboard.results import (
    NIS_WINDOW,
    blueprint,
    log_result,
    replay,
    save_rrd,
    stream,
)

__all__ = [
    "APPLICATION", "NIS_WINDOW", "TIMELINE", "blueprint", "explanation_blueprint", "file_sink",
    "log_explanation", "log_result", "replay", "save_explanation_rrd", "save_poses_rrd",
    "save_rrd", "stream",
]  # fmt: skip
