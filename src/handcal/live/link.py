"""The link to the page: a token that cannot be guessed, kept for the session's folder."""

from __future__ import annotations

import json
import os
import secrets
import socket
from dataclasses import asdict, dataclass
from pathlib import Path

from handcal.types import InputError

LOOPBACK = "127.0.0.1"
NAME = ".handcal-live.json"
NEEDED = "handcal live needs aiohttp, trustme and segno: in a checkout, `make live` installs them"


@dataclass(frozen=True)
class Link:
    """Where the page is. certificate: PEM of key and chain, empty without TLS."""

    token: str
    host: str
    port: int
    certificate: str = ""

    @property
    def url(self) -> str:
        """As it is opened."""
        scheme = "https" if self.certificate else "http"
        return f"{scheme}://{self.host}:{self.port}/{self.token}/"

    @property
    def hosts(self) -> frozenset[str]:
        """What a request may call this machine."""
        names = {self.host, LOOPBACK, "localhost"}
        return frozenset(f"{name}:{self.port}" for name in names)


def link_of(folder: Path, lan: bool, port: int | None, plain: bool = False) -> Link:
    """The folder's link, the same as before if it had one; otherwise a new one, kept in a file
    that only its owner can read. plain: not encrypted in a network either. Errors: InputError for
    a damaged file."""
    path, host = folder / NAME, own_address() if lan else LOOPBACK
    before, tls = _kept(path), lan and not plain
    same = before is not None and before.host == host and bool(before.certificate) == tls
    if before is not None and same and port in (None, before.port):
        return before
    link = Link(
        secrets.token_urlsafe(24) if before is None else before.token,
        host, port or _free_port(host), _certificate(host) if tls else "",
    )  # fmt: skip
    path.unlink(missing_ok=True)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        json.dump(asdict(link), file)
    return link


def _kept(path: Path) -> Link | None:
    if not path.exists():
        return None
    try:
        return Link(**json.loads(path.read_text("utf-8")))
    except (ValueError, TypeError):
        raise InputError(f"{path} is damaged; remove it, and the link will be a new one.") from None


def own_address() -> str:
    """This machine's address in its network. Nothing is sent to find it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        try:
            s.connect(("192.0.2.1", 9))  # (an unused address: it only picks the interface)
            return str(s.getsockname()[0])
        except OSError:
            raise InputError("--lan: this machine is in no network.") from None


def _free_port(host: str) -> int:
    with socket.socket() as s:
        s.bind((host, 0))
        return int(s.getsockname()[1])


def _certificate(host: str) -> str:
    try:
        import trustme
    except ImportError:
        raise InputError(f"{NEEDED}.") from None
    made = trustme.CA(organization_name="handcal").issue_cert(host)
    chain = b"".join(part.bytes() for part in made.cert_chain_pems)
    pem: bytes = made.private_key_pem.bytes() + chain
    return pem.decode("ascii")


def qr(url: str) -> str:
    """The link as a picture of block letters; empty where segno is not installed."""
    import io

    try:
        import segno
    except ImportError:
        return ""
    out = io.StringIO()
    segno.make(url, error="l").terminal(out, compact=True)
    return out.getvalue()
