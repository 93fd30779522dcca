"""ROS 2 bags and MCAP: messages of type JointState."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rx90b_flex.signals.readers.reader import Log, Reader

JOINT_STATE = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")


class BagReader(Reader):
    """Positions, velocities and efforts of one topic."""

    endings = (".mcap", ".db3", ".bag")

    @classmethod
    def takes_folder(cls, folder: Path) -> bool:
        return (folder / "metadata.yaml").is_file()

    def read(self, path: Path) -> Log:
        return self.read_topic(path, None)

    def read_topic(self, path: Path, topic: str | None) -> Log:
        """JointState messages; the time is their header's, or the recorder's where that is zero."""
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise ValueError(f"{path}: bags need the package rosbags: pip install 'rx90b-flex[ros]'") from None
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            states = [c for c in reader.connections if c.msgtype in JOINT_STATE]
            chosen, notes = _topic(path, {c.topic: c.msgcount for c in states}, topic)
            messages = [
                (stamp, reader.deserialize(raw, connection.msgtype))
                for connection, stamp, raw in reader.messages([c for c in states if c.topic == chosen])
            ]
        return _joint_states(path, messages, [f"topic {chosen}, {len(messages)} messages", *notes])


def _topic(path: Path, counts: Mapping[str, int], topic: str | None) -> tuple[str, list[str]]:
    if not counts:
        raise ValueError(f"{path}: no topic of type sensor_msgs/JointState")
    if topic is not None:
        if topic not in counts:
            raise ValueError(
                f"{path}: no topic {topic!r} of type sensor_msgs/JointState; it has {', '.join(sorted(counts))}"
            )
        return topic, []
    chosen = max(sorted(counts), key=lambda name: counts[name])
    others = [name for name in sorted(counts) if name != chosen]
    return chosen, [f"other topics of the same type: {', '.join(others)} (choose with --topic)"] if others else []


def _joint_states(path: Path, messages: list[tuple[int, Any]], notes: list[str]) -> Log:
    joints = list(dict.fromkeys(name for _, message in messages for name in message.name))
    fields = {"motor_position": "position", "motor_velocity": "velocity", "torque": "effort"}
    values = np.full((len(messages), len(fields), len(joints)), np.nan)
    places = {joint: k for k, joint in enumerate(joints)}
    for row, (_, message) in enumerate(messages):
        at = [places[name] for name in message.name]
        if len(set(at)) < len(at):
            twice = next(name for name in message.name if list(message.name).count(name) > 1)
            raise ValueError(
                f"{path}: message {row + 1} names {twice!r} {list(message.name).count(twice)} times; once is expected"
            )
        for f, field in enumerate(fields.values()):
            given = np.asarray(getattr(message, field), dtype=float)
            if len(given) == len(at):  # a field may be left empty
                values[row, f, at] = given
    # a message may carry some joints only: a row counts where it has all that it could have
    whole = ~np.isnan(values).all(axis=0)
    complete = ~np.isnan(values[:, whole]).any(axis=1)
    if complete.sum() < 2:
        raise ValueError(f"{path}: no two messages hold all of {', '.join(joints)}")
    if not complete.all():
        notes.append(f"{np.count_nonzero(~complete)} messages without all joints left out")
    header = np.array([int(m.header.stamp.sec) * 10**9 + int(m.header.stamp.nanosec) for _, m in messages])
    stamps = np.array([stamp for stamp, _ in messages])
    used = header if header.any() else stamps
    notes.append(
        "time: " + ("of the messages' headers" if header.any() else "of the recorder, for the headers have none")
    )
    used = used[complete]
    every = ((f"{field}/{joint}", (signal, joint)) for signal, field in fields.items() for joint in joints)
    roles = {name: role for (name, role), there in zip(every, whole.ravel(), strict=True) if there}
    columns = values[complete][:, whole]
    clocks = {"time": float(used[0]) * 1e-9}
    return Log(path, tuple(roles), columns, tuple(notes), (used - used[0]) * 1e-9, roles, clocks=clocks)
