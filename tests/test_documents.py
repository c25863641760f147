"""What cannot be read as JSON or TOML is said in one sentence that names the file."""

from __future__ import annotations

from pathlib import Path

import pytest

from handcal.documents import read_json, read_toml
from handcal.types import InputError

DAMAGED = {"not utf-8": b"\xff\xfe", "cut off": b"{", "too deep": b"[" * 200_000}


@pytest.mark.parametrize(("read", "name"), [(read_json, "JSON"), (read_toml, "TOML")])
def test_what_cannot_be_read_is_said(tmp_path: Path, read, name: str):
    with pytest.raises(InputError, match=f"^{tmp_path / 'none'} cannot be read: No such file"):
        read(tmp_path / "none")
    with pytest.raises(InputError, match=f"^{tmp_path} cannot be read: Is a directory"):
        read(tmp_path)
    for kind, data in DAMAGED.items():
        path = tmp_path / kind
        path.write_bytes(data)
        with pytest.raises(InputError, match=f"^{path} is not {name}"):
            read(path)
