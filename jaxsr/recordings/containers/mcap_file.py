"""MCAP by mcap: messages in JSON, and those of ROS 1 and 2 by the definitions in the file."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from mcap.reader import make_reader
from messages import Columns


def read(path: str) -> list[tuple[str, np.ndarray, np.ndarray, str]]:
    """Return name, time in s, values and unit of every number in the messages."""
    columns, decode = Columns(), _Decoder()
    with open(path, "rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            content = decode(channel.message_encoding, schema, message.data)
            if content is not None:
                columns.add(channel.topic, message.log_time, content)
    return columns.channels()


class _Decoder:
    """Decodes messages; those of ROS by their own definitions."""

    def __init__(self) -> None:
        self._store: Any = None
        self._known: set[str] = set()

    def __call__(self, encoding: str, schema: Any, data: bytes) -> Any:
        """Return a message; None where its encoding is another."""
        if encoding == "json":
            return json.loads(data)
        if encoding not in ("cdr", "ros1") or schema is None:
            return None
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        if self._store is None:
            self._store = get_typestore(Stores.EMPTY)
        name = schema.name if schema.name.count("/") > 1 else schema.name.replace("/", "/msg/")
        if name not in self._known:
            self._store.register(get_types_from_msg(schema.data.decode("utf-8"), name))
            self._known.add(name)
        if encoding == "cdr":
            return self._store.deserialize_cdr(data, name)
        return self._store.deserialize_ros1(data, name)
