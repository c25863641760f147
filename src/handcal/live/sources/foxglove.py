"""Topics over a Foxglove WebSocket, as foxglove_bridge and the Foxglove SDK serve them.

The server says its channels (``advertise``); those of a schema that handcal reads are subscribed
to; their messages come as binary: 1, the subscription (uint32), the time of receipt (uint64, ns),
the message as its channel encodes it (CDR or JSON). All numbers little endian.
"""

from __future__ import annotations

import asyncio
import json
import queue
import struct
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from handcal.live.session import Session
from handcal.live.sources.mcap import record
from handcal.live.sources.pairing import Pairing
from handcal.recordings.follow import Arriving
from handcal.recordings.inputs import Options
from handcal.recordings.inputs._messages import Topic, schema_key
from handcal.recordings.inputs._topics import parts_of, readable
from handcal.types import InputError

# By the specification's first edition, and by the SDK that followed it.
PROTOCOLS = ("foxglove.websocket.v1", "foxglove.sdk.v1")
MESSAGE_DATA, HEAD = 1, struct.Struct("<BIQ")
# No message of an IMU is as large; a server that sends pictures is not asked for them.
LARGEST = 2**20
# Messages that wait to be recorded: a minute of five topics at 400 Hz.
MOST_WAITING = 120_000
PATIENCE_S = 10.0


@dataclass
class Connected:
    """A server that is listened to, in a thread of its own. channels: by subscription; waiting:
    subscription, time of receipt and message; ended: why nothing comes any more."""

    url: str
    arriving: Arriving
    pairing: Pairing = field(default_factory=Pairing)
    channels: dict[int, Topic] = field(default_factory=dict)
    waiting: queue.Queue[tuple[int, int, bytes]] = field(
        default_factory=lambda: queue.Queue(MOST_WAITING)
    )
    ready: threading.Event = field(default_factory=threading.Event)
    ended: str = ""

    def pull(self, into: Session) -> bool:
        """Record what has come; False once the server has gone. Errors: InputError where several
        topics fit a stream; Refused."""
        by_channel: dict[int, list[tuple[int, bytes]]] = {}
        gone = bool(self.ended)
        while not self.waiting.empty():
            subscription, ns, data = self.waiting.get_nowait()
            by_channel.setdefault(subscription, []).append((ns, data))
        topics = [_topic(self.channels[s], some) for s, some in by_channel.items()]
        record(self.arriving.news(topics), self.pairing, into, "foxglove")
        return not gone

    async def listen(self) -> None:
        """Until the server closes."""
        import aiohttp

        try:
            async with (
                aiohttp.ClientSession() as session,
                session.ws_connect(
                    self.url, protocols=PROTOCOLS, max_msg_size=LARGEST, heartbeat=PATIENCE_S
                ) as socket,
            ):
                if socket.protocol not in PROTOCOLS:
                    self.ended = "it speaks another protocol"
                    return
                async for message in socket:
                    if message.type == aiohttp.WSMsgType.TEXT:
                        await self._heard(socket, message.data)
                    elif message.type == aiohttp.WSMsgType.BINARY:
                        self._received(message.data)
            self.ended = self.ended or "it has closed the connection"
        except (aiohttp.ClientError, OSError, TimeoutError) as error:
            self.ended = str(error) or type(error).__name__
        finally:
            self.ended = self.ended or "it has closed the connection"
            self.ready.set()

    async def _heard(self, socket: Any, text: str) -> None:
        """Subscribe to what is advertised and can be read."""
        try:
            said = json.loads(text)
        except (ValueError, RecursionError):
            return
        if not isinstance(said, dict) or said.get("op") != "advertise":
            return
        asked = []
        for channel in said.get("channels", []):
            if not isinstance(channel, dict) or type(channel.get("id")) is not int:
                continue
            schema = schema_key(str(channel.get("schemaName", "")))
            topic = Topic(str(channel.get("topic")), schema, str(channel.get("encoding")), ())
            if readable(topic) and topic.encoding in ("cdr", "json"):
                subscription = len(self.channels)
                self.channels[subscription] = topic
                asked.append({"id": subscription, "channelId": channel["id"]})
        if asked:
            await socket.send_json({"op": "subscribe", "subscriptions": asked})
            self.ready.set()

    def _received(self, data: bytes) -> None:
        if len(data) < HEAD.size:
            return
        kind, subscription, ns = HEAD.unpack_from(data)
        if kind == MESSAGE_DATA and subscription in self.channels and not self.waiting.full():
            self.waiting.put_nowait((subscription, ns, data[HEAD.size :]))


def _topic(channel: Topic, messages: list[tuple[int, bytes]]) -> Topic:
    """The channel with these messages decoded. Errors: InputError."""
    buffer = np.frombuffer(b"".join(data for _, data in messages), dtype=np.uint8)
    lengths = np.array([len(data) for _, data in messages], dtype=np.int64)
    starts = np.cumsum(lengths) - lengths
    log = np.array([min(ns, 2**62) for ns, _ in messages], dtype=np.int64)
    parts = parts_of(buffer, starts, lengths, log, starts, channel)
    return Topic(channel.name, channel.schema, channel.encoding, tuple(parts))


def connected(url: str, options: Options) -> Connected:
    """The server at ws://HOST:PORT, listened to. Errors: InputError where there is none, or where
    it has no topic that could be read."""
    url = url if "//" in url else f"ws://{url}"
    made = Connected(url, Arriving(Path(url), options))
    threading.Thread(target=lambda: asyncio.run(made.listen()), daemon=True).start()
    heard = made.ready.wait(PATIENCE_S)
    if made.ended:
        raise InputError(f"No Foxglove WebSocket at {url}: {made.ended}.")
    if not heard:
        raise InputError(f"{url} has no topic of an IMU (sensor_msgs/msg/Imu in CDR or JSON).")
    return made
