"""Recordings of test benches and robots: a file of each kind is made here and read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.recordings import read_recording
from jaxsr.recordings.containers import opened as opening

TIME = 0.01 * np.arange(200)
ANGLE, TORQUE = np.sin(TIME), np.cos(3.0 * TIME)
SLOW = 0.05 * np.arange(40)


def test_hdf5_vectors_tables_and_matrices(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["bench/time"] = TIME
        file["bench/torque"] = TORQUE
        file["bench/torque"].attrs["unit"] = "N*m"
        file["bench/both"] = np.stack([ANGLE, TORQUE])  # channels along the first axis
        file["bench/note"] = "a text"
    found = read_recording(tmp_path / "run.h5")
    assert found.time == pytest.approx(TIME)
    assert found.channel("torque") == pytest.approx(TORQUE)
    assert found.channel("both_1") == pytest.approx(ANGLE)
    with h5py.File(tmp_path / "two.h5", "w") as file:
        for group in ("a", "b"):
            file[f"{group}/x"] = ANGLE
        file["a/t"] = TIME
    assert set(read_recording(tmp_path / "two.h5", time="a/t").channels) == {"a/x", "b/x"}


def test_tdms_waveforms_of_two_rates(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")

    def wave(name: str, values: np.ndarray, step: float) -> object:
        return nptdms.ChannelObject("Bench", name, values, {"wf_increment": step})

    with nptdms.TdmsWriter(str(tmp_path / "run.tdms")) as writer:
        slow = np.sin(SLOW)
        writer.write_segment([wave("angle", ANGLE, 0.01), wave("slow", slow, 0.05)])
    found = read_recording(tmp_path / "run.tdms")
    assert found.time == pytest.approx(TIME)
    assert found.channel("angle") == pytest.approx(ANGLE)
    seen = np.isfinite(found.channel("slow"))
    assert seen.sum() == 40
    assert found.channel("slow")[seen] == pytest.approx(np.sin(SLOW))
    assert found.time[seen] == pytest.approx(SLOW)


@pytest.mark.long
def test_mdf4_groups_of_two_rasters(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(ANGLE, TIME, name="angle", unit="rad")])
        file.append([asammdf.Signal(np.sin(SLOW), SLOW, name="slow", unit="rad")])
        file.save(tmp_path / "run.mf4")
    found = read_recording(tmp_path / "run.mf4")
    assert found.time == pytest.approx(TIME)
    assert found.channel("angle") == pytest.approx(ANGLE)
    assert np.isfinite(found.channel("slow")).sum() == 40


def test_mcap_messages_in_json_and_of_ros(tmp_path: Path) -> None:
    writing = pytest.importorskip("mcap.writer")
    rosbags = pytest.importorskip("rosbags.typesys")
    store = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)
    kind = "geometry_msgs/msg/Point"
    text, _ = store.generate_msgdef(kind)
    with open(tmp_path / "run.mcap", "wb") as stream:
        writer = writing.Writer(stream)
        writer.start()
        plain = writer.register_schema("torque", "jsonschema", b"{}")
        ros = writer.register_schema(kind, "ros2msg", text.encode())
        torque = writer.register_channel("/torque", "json", plain)
        point = writer.register_channel("/tool", "cdr", ros)
        for k, t in enumerate(TIME):
            at = 1_700_000_000_000_000_000 + round(1e9 * t)
            writer.add_message(torque, at, f'{{"value": {TORQUE[k]}}}'.encode(), at)
            message = store.types[kind](x=ANGLE[k], y=0.0, z=float(k))
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(point, at, data, at)
        writer.finish()
    found = read_recording(tmp_path / "run.mcap")
    assert found.time == pytest.approx(TIME)
    assert found.channel("/torque.value") == pytest.approx(TORQUE)
    assert found.channel("/tool.x") == pytest.approx(ANGLE)


def test_bags_of_ros_name_the_joints(tmp_path: Path) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    kind = "sensor_msgs/msg/JointState"
    header, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    with rosbag1.Writer(tmp_path / "run.bag") as writer:
        topic = writer.add_connection("/joint_states", kind, typestore=store)
        for k, t in enumerate(TIME):
            at = 1_700_000_000_000_000_000 + round(1e9 * t)
            message = store.types[kind](
                header=header(seq=k, stamp=stamp(sec=at // 10**9, nanosec=at % 10**9), frame_id=""),
                name=["elbow", "wrist"],
                position=np.array([ANGLE[k], 0.5]),
                velocity=np.array([]),
                effort=np.array([TORQUE[k], 0.0]),
            )
            late = at + 3_000_000 * (k % 2)  # the log is late, the header is not
            writer.write(topic, late, store.serialize_ros1(message, kind))
    found = read_recording(tmp_path / "run.bag")
    assert found.time == pytest.approx(TIME)
    assert found.channel("/joint_states.position[elbow]") == pytest.approx(ANGLE)
    assert found.channel("/joint_states.effort[elbow]") == pytest.approx(TORQUE)


@pytest.mark.parametrize("storage", ["db3", "mcap"])
def test_bags_of_ros_2_name_the_joints(tmp_path: Path, storage: str) -> None:
    """Its numbers come back bit for bit, at the times of the headers, in s from the first."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    kind, twist = "sensor_msgs/msg/JointState", "geometry_msgs/msg/Vector3"
    header, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    plugin = {"db3": rosbag2.StoragePlugin.SQLITE3, "mcap": rosbag2.StoragePlugin.MCAP}[storage]
    begin = 1_700_000_000_250_000_000
    with rosbag2.Writer(tmp_path / "bag", version=8, storage_plugin=plugin) as writer:
        joints = writer.add_connection("/joint_states", kind, typestore=store)
        wrench = writer.add_connection("/torque", twist, typestore=store)
        for k, t in enumerate(TIME):
            at = begin + round(1e9 * t)
            message = store.types[kind](
                header=header(stamp=stamp(sec=at // 10**9, nanosec=at % 10**9), frame_id="base"),
                name=["elbow", "wrist"],
                position=np.array([ANGLE[k], 0.5]),
                velocity=np.array([]),
                effort=np.array([TORQUE[k], np.nan]),
            )
            late = at + 3_000_000 * (k % 2)  # the log is late, the header is not
            writer.write(joints, late, store.serialize_cdr(message, kind))
            if k % 5 == 0:  # a type without a header: the time of the log
                vector = store.types[twist](x=TORQUE[k], y=0.0, z=0.0)
                writer.write(wrench, at, store.serialize_cdr(vector, twist))
    (path,) = (tmp_path / "bag").glob(f"*.{storage}")
    found = read_recording(path)
    assert set(found.channels) == {
        *(f"/joint_states.position[{joint}]" for joint in ("elbow", "wrist")),
        *(f"/joint_states.effort[{joint}]" for joint in ("elbow", "wrist")),
        *(f"/torque.{axis}" for axis in "xyz"),
    }
    assert found.time == pytest.approx(TIME, abs=1e-9) and found.time_stated
    np.testing.assert_array_equal(found.channel("/joint_states.position[elbow]"), ANGLE)
    np.testing.assert_array_equal(found.channel("/joint_states.effort[elbow]"), TORQUE)
    assert np.isnan(found.channels["/joint_states.effort[wrist]"]).all()
    slow = found.channel("/torque.x")
    np.testing.assert_array_equal(slow[::5], TORQUE[::5])
    assert np.isfinite(slow).sum() == 40


@pytest.fixture
def damaged(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "run.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(range(256)))
    yield path


def test_a_damaged_file_and_a_missing_library_are_one_line_each(
    damaged: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("h5py")
    with pytest.raises(InputError, match=r"cannot be read as \.h5"):
        read_recording(damaged)
    script = tmp_path / "child.py"
    script.write_text('import sys\nprint(\'{"missing": "h5py"}\', file=sys.stderr)\nsys.exit(3)\n')
    monkeypatch.setattr(opening, "SCRIPT", script)
    with pytest.raises(InputError, match=r"needs h5py.*jaxsr-dynamics\[formats\]"):
        read_recording(damaged)
    script.write_text("import os\nos.abort()\n")  # what damaged files do to libraries in C
    with pytest.raises(InputError, match=r"cannot be read as \.h5: damaged"):
        read_recording(damaged)
