"""The process that explains recordings for `prove`, with a folder of effect files or none."""

from __future__ import annotations

import sys
from pathlib import Path

from handcal.user_effects import effects_from
from handcal_sim.prove.run import explained
from handcal_sim.prove.workers import serve

with effects_from(Path(sys.argv[1]) if sys.argv[1:] else None):
    serve(explained)
