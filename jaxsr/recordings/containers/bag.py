"""Bags of ROS 1 (``.bag``) and ROS 2 (``.db3`` beside its ``metadata.yaml``) by rosbags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from messages import Columns
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore


def read(path: str) -> list[tuple[str, np.ndarray, np.ndarray, str]]:
    """Return name, time in s, values and unit of every number in the messages."""
    place = Path(path) if path.endswith(".bag") else Path(path).parent
    columns = Columns()
    with AnyReader([place], default_typestore=get_typestore(Stores.LATEST)) as bag:
        for connection, nanoseconds, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            columns.add(connection.topic, nanoseconds, message)
    return columns.channels()
