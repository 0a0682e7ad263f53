"""ROS 1 and 2 bags and MCAP, written by the rosbags library itself, read as drive logs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrocal.commands.replay import ReplayRequest, replay_to_directory
from gyrocal.errors import DataError, InputError, ProfileError
from gyrocal.records import bags
from gyrocal.records.bags import Wheels, is_bag, iterate_bag
from gyrocal.records.drive import join
from gyrocal.report import navigation
from tests.records.whole import read_bag

rosbags = pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import StoragePlugin  # noqa: E402
from rosbags.rosbag2 import Writer as Writer2  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

STORE1 = get_typestore(Stores.ROS1_NOETIC)
STORE2 = get_typestore(Stores.ROS2_HUMBLE)
SEPARATION_M, SPEED_MPS, TURN_RADPS = 0.5, 1.2, 0.3
WHEELS = Wheels(SEPARATION_M, 0.1)


class Messages:
    """Messages of a robot that drives a circle, in the types of one ROS."""

    def __init__(self, store: Any, ros1: bool) -> None:
        self.store, self.ros1 = store, ros1
        #: A robot that weaves turns now and then; its heading is the integral of its rate.
        self.weave = False

    def type(self, name: str) -> Any:
        return self.store.types[name]

    def header(self, t_s: float) -> Any:
        time = self.type("builtin_interfaces/msg/Time")(sec=int(t_s), nanosec=round((t_s % 1) * 1e9))
        extra = {"seq": 0} if self.ros1 else {}
        return self.type("std_msgs/msg/Header")(stamp=time, frame_id="base", **extra)

    def vector(self, z: float = 0.0, x: float = 0.0) -> Any:
        return self.type("geometry_msgs/msg/Vector3")(x=x, y=0.0, z=z)

    def heading(self, t_s: float) -> float:
        return float(-4.0 * TURN_RADPS * np.cos(0.5 * t_s)) if self.weave else TURN_RADPS * t_s

    def rate(self, t_s: float) -> float:
        # A gyro that never changes at all would be a stuck one.
        steady = TURN_RADPS + 1e-5 * float(np.sin(37.0 * t_s))
        return float(2.0 * TURN_RADPS * np.sin(0.5 * t_s)) if self.weave else steady

    def pose(self, t_s: float) -> Any:
        radius, heading = SPEED_MPS / TURN_RADPS, self.heading(t_s)
        point = self.type("geometry_msgs/msg/Point")(
            x=radius * np.sin(heading), y=radius * (1 - np.cos(heading)), z=0.0
        )
        turn = self.type("geometry_msgs/msg/Quaternion")(
            x=0.0, y=0.0, z=np.sin(heading / 2), w=np.cos(heading / 2)
        )
        return self.type("geometry_msgs/msg/Pose")(position=point, orientation=turn)

    def imu(self, t_s: float) -> Any:
        return self.type("sensor_msgs/msg/Imu")(
            header=self.header(t_s),
            orientation=self.pose(0.0).orientation,
            orientation_covariance=np.zeros(9),
            angular_velocity=self.vector(self.rate(t_s), 1e-3 * float(np.sin(91.0 * t_s))),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self.vector(),
            linear_acceleration_covariance=np.zeros(9),
        )

    def odometry(self, t_s: float) -> Any:
        twist = self.type("geometry_msgs/msg/Twist")(linear=self.vector(), angular=self.vector())
        return self.type("nav_msgs/msg/Odometry")(
            header=self.header(t_s),
            child_frame_id="base",
            pose=self.type("geometry_msgs/msg/PoseWithCovariance")(
                pose=self.pose(t_s), covariance=np.zeros(36)
            ),
            twist=self.type("geometry_msgs/msg/TwistWithCovariance")(twist=twist, covariance=np.zeros(36)),
        )

    def joints(self, t_s: float, names: tuple[str, ...]) -> Any:
        half = 0.5 * SEPARATION_M * TURN_RADPS
        speeds = [SPEED_MPS + (half if "right" in name else -half) for name in names]
        angles = np.array([s * t_s / 0.1 for s in speeds])
        return self.type("sensor_msgs/msg/JointState")(
            header=self.header(t_s), name=list(names), position=angles, velocity=angles, effort=angles
        )

    def pose_stamped(self, t_s: float) -> Any:
        return self.type("geometry_msgs/msg/PoseStamped")(header=self.header(t_s), pose=self.pose(t_s))

    def twist(self, t_s: float) -> Any:
        twist = self.type("geometry_msgs/msg/Twist")(linear=self.vector(x=SPEED_MPS), angular=self.vector())
        return self.type("geometry_msgs/msg/TwistStamped")(header=self.header(t_s), twist=twist)

    def transforms(self, t_s: float) -> Any:
        pose = self.pose(t_s)
        at = self.type("geometry_msgs/msg/Vector3")(x=pose.position.x, y=pose.position.y, z=0.0)
        move = self.type("geometry_msgs/msg/Transform")(translation=at, rotation=pose.orientation)
        still = self.type("geometry_msgs/msg/Transform")(translation=self.vector(), rotation=pose.orientation)
        stamped = self.type("geometry_msgs/msg/TransformStamped")
        header = self.header(t_s)
        header.frame_id = "map"
        pair = [stamped(header, "base", move), stamped(header, "laser", still)]
        return self.type("tf2_msgs/msg/TFMessage")(transforms=pair)

    def fix(self, t_s: float) -> Any:
        """Metres to degrees at 50 degrees north by the lengths of a degree there (111,229 m and 71,696 m)."""
        pose = self.pose(t_s)
        status = self.type("sensor_msgs/msg/NavSatStatus")(status=0, service=1)
        return self.type("sensor_msgs/msg/NavSatFix")(
            header=self.header(t_s),
            status=status,
            latitude=50.0 + pose.position.y / 111_229.0,
            longitude=8.0 + pose.position.x / 71_696.0,
            altitude=0.0,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )

    def temperature(self, t_s: float) -> Any:
        return self.type("sensor_msgs/msg/Temperature")(
            header=self.header(t_s), temperature=20.0 + t_s, variance=0.0
        )


def write_bag(
    path: Path,
    kind: str,
    topics: dict[str, str],
    *,
    wheel_delay_s: float = 0.0,
    last_s: float = 4.0,
    weave: bool = False,
    jump_s: float = 0.0,
) -> Path:
    """A bag from 1 s to `last_s`: gyro at 50 Hz, wheels at 20 Hz; `topics` maps topic to type."""
    ros1 = kind == "bag"
    m = Messages(STORE1 if ros1 else STORE2, ros1)
    m.weave = weave
    times = {
        topic: np.arange(1.0, last_s, 0.02 if t == "sensor_msgs/msg/Imu" else 0.05)
        for topic, t in topics.items()
    }
    names = ("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel")
    if "none" in path.stem:
        names = ("a", "b", "c", "d")
    build = {
        "sensor_msgs/msg/Imu": m.imu,
        "nav_msgs/msg/Odometry": m.odometry,
        "sensor_msgs/msg/JointState": lambda t: m.joints(t, names),
        "sensor_msgs/msg/Temperature": m.temperature,
        "geometry_msgs/msg/PoseStamped": m.pose_stamped,
        "geometry_msgs/msg/TwistStamped": m.twist,
        "tf2_msgs/msg/TFMessage": m.transforms,
        "sensor_msgs/msg/NavSatFix": m.fix,
    }
    writer: Any = (
        Writer1(path)
        if ros1
        else Writer2(
            path,
            version=9,
            storage_plugin=StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3,
        )
    )
    with writer:
        rows = sorted((t, topic) for topic, ts in times.items() for t in ts)
        connections = {
            topic: writer.add_connection(topic, t, typestore=m.store) for topic, t in topics.items()
        }
        serialize = m.store.serialize_ros1 if ros1 else m.store.serialize_cdr
        for t, topic in rows:
            late = wheel_delay_s if topic != "/imu" else 0.0
            message = build[topics[topic]](t + late)
            if jump_s and t > 0.5 * last_s:
                message.header.stamp.sec += int(jump_s)
            raw = serialize(message, topics[topic])
            writer.write(connections[topic], round(t * 1e9), raw)
    return path


IMU_ODOMETRY = {"/imu": "sensor_msgs/msg/Imu", "/odom": "nav_msgs/msg/Odometry"}


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
@pytest.mark.parametrize("wheels", ["nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"])
def test_a_circle_reads_as_a_circle(tmp_path: Path, kind: str, wheels: str) -> None:
    topics = {"/imu": "sensor_msgs/msg/Imu", "/wheels": wheels, "/t": "sensor_msgs/msg/Temperature"}
    path = write_bag(tmp_path / ("run.bag" if kind == "bag" else "run"), kind, topics)
    assert is_bag(path)
    log = read_bag(path, WHEELS)
    duration_s = log.t_s[-1] - log.t_s[0]
    half = 0.5 * SEPARATION_M * TURN_RADPS
    assert log.left_m.sum() == pytest.approx((SPEED_MPS - half) * duration_s, rel=1e-4)
    assert log.right_m.sum() == pytest.approx((SPEED_MPS + half) * duration_s, rel=1e-4)
    np.testing.assert_allclose(log.gyro_dps, np.degrees(TURN_RADPS), atol=1e-3)
    np.testing.assert_allclose(np.diff(log.t_s), 0.02, atol=1e-6)
    np.testing.assert_allclose(np.diff(log.gyro_temp_c), 0.02, atol=1e-6)
    assert np.isnan(log.truth_x_m).all()
    if kind != "bag":
        (inside,) = [p for p in path.iterdir() if p.suffix in (".mcap", ".db3")]
        np.testing.assert_array_equal(read_bag(inside, WHEELS).t_s, log.t_s)


def test_truth_is_taken_from_the_named_topic(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", "mcap", IMU_ODOMETRY | {"/truth": "nav_msgs/msg/Odometry"})
    log = read_bag(path, WHEELS, {"wheels": "/odom", "truth": "/truth"})
    known = np.flatnonzero(np.isfinite(log.truth_x_m))
    assert known.size > 50
    t_s = 1.0 + log.t_s[known]
    np.testing.assert_allclose(log.truth_heading_deg[known], np.degrees(TURN_RADPS * t_s), atol=0.4)


def test_blocks_are_the_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(tmp_path / "run", "mcap", IMU_ODOMETRY, last_s=20.0)
    whole = read_bag(path, WHEELS)
    monkeypatch.setattr(bags, "_FLUSH_MESSAGES", 50)
    blocks = list(iterate_bag(path, WHEELS))
    assert len(blocks) > 5
    again = join(blocks)
    for name in ("t_s", "left_m", "right_m", "gyro_dps"):
        np.testing.assert_allclose(getattr(again, name), getattr(whole, name), atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "topic"),
    [
        ("geometry_msgs/msg/PoseStamped", "/truth"),
        ("sensor_msgs/msg/NavSatFix", "/truth"),
        ("tf2_msgs/msg/TFMessage", "/truth:map:base"),
    ],
)
def test_every_kind_of_truth(tmp_path: Path, kind: str, topic: str) -> None:
    path = write_bag(tmp_path / "run", "mcap", IMU_ODOMETRY | {"/truth": kind})
    log = read_bag(path, WHEELS, {"truth": topic})
    known = np.flatnonzero(np.isfinite(log.truth_x_m))
    assert known.size > 50
    t_s, radius = 1.0 + log.t_s[known], SPEED_MPS / TURN_RADPS
    turned = TURN_RADPS * np.stack((t_s, np.zeros(t_s.size) + (1.0 if "Nav" in kind else 0.0)))
    x, y = radius * np.sin(turned), radius * (1.0 - np.cos(turned))
    # A row of truth goes to the next gyro sample, 0.02 s later at most. Fixes count from the first one.
    np.testing.assert_allclose(log.truth_x_m[known], x[0] - x[1], atol=0.03)
    np.testing.assert_allclose(log.truth_y_m[known], y[0] - y[1], atol=0.03)
    assert np.isnan(log.truth_heading_deg[known]).all() == ("Nav" in kind)
    if "TF" in kind:
        with pytest.raises(InputError, match="say which transform is the truth"):
            read_bag(path, WHEELS, {"truth": "/truth"})


def test_one_speed_in_a_bag(tmp_path: Path) -> None:
    topics = {"/imu": "sensor_msgs/msg/Imu", "/speed": "geometry_msgs/msg/TwistStamped"}
    log = read_bag(write_bag(tmp_path / "run", "mcap", topics), WHEELS)
    assert log.speed_only
    assert log.left_m.sum() == pytest.approx(SPEED_MPS * log.t_s[-1], rel=1e-6)


def test_turns_on_another_axis_are_told(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", "mcap", IMU_ODOMETRY, last_s=40.0, weave=True)
    np.testing.assert_allclose(read_bag(path, WHEELS).gyro_dps.max(), np.degrees(2 * TURN_RADPS), rtol=0.01)
    with pytest.raises(InputError, match=r"the turns of the wheels are on the IMU's z axis .* say --axis z."):
        read_bag(path, Wheels(SEPARATION_M, 0.1, "x"))
    inverted = read_bag(path, Wheels(SEPARATION_M, 0.1, "-z"))
    np.testing.assert_allclose(inverted.gyro_dps, -read_bag(path, WHEELS).gyro_dps)


def test_a_clock_that_jumps_is_closed_for_every_topic(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", "mcap", IMU_ODOMETRY, last_s=20.0, jump_s=1.7e9)
    log = read_bag(path, WHEELS)
    np.testing.assert_allclose(np.diff(log.t_s), 0.02, atol=1e-5)
    assert log.segment[-1] == 1
    assert log.left_m.sum() == pytest.approx((SPEED_MPS - 0.075) * log.t_s[-1], rel=1e-3)
    assert "time steps by 1.7e+09 s" in log.notes[0]


def test_several_candidates_are_not_chosen_between(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run.bag", "bag", IMU_ODOMETRY | {"/odom2": "nav_msgs/msg/Odometry"})
    with pytest.raises(InputError) as error:
        read_bag(path, WHEELS)
    assert str(error.value).endswith(
        "several (/odom, /odom2) of type nav_msgs/msg/Odometry or sensor_msgs/msg/JointState or geometry_msgs/msg/TwistStamped; say which one is wheels with --topic wheels=TOPIC."
    )
    with pytest.raises(InputError, match="topic '/imu' cannot be wheels"):
        read_bag(path, WHEELS, {"wheels": "/imu"})


def test_a_bag_without_gyro_is_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run.bag", "bag", {"/odom": "nav_msgs/msg/Odometry"})
    with pytest.raises(InputError, match="none of type sensor_msgs/msg/Imu; say which one is imu"):
        read_bag(path, WHEELS)


def test_joints_need_a_radius_and_sides(tmp_path: Path) -> None:
    topics = {"/imu": "sensor_msgs/msg/Imu", "/joints": "sensor_msgs/msg/JointState"}
    with pytest.raises(ProfileError, match="no wheel_radius_m; add it there"):
        read_bag(write_bag(tmp_path / "run.bag", "bag", topics), Wheels(0.5))
    with pytest.raises(InputError, match="names must contain left and right"):
        read_bag(write_bag(tmp_path / "none.bag", "bag", topics), WHEELS)


def test_clocks_that_do_not_overlap_are_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run.bag", "bag", IMU_ODOMETRY, wheel_delay_s=100.0)
    with pytest.raises(DataError, match="gyro and wheels do not overlap in time"):
        read_bag(path, WHEELS)


def test_wheels_that_come_only_once_are_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run.bag", "bag", IMU_ODOMETRY, last_s=1.04)
    with pytest.raises(DataError, match="say something only once"):
        read_bag(path, WHEELS)


def test_what_is_not_a_bag_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "fake.bag"
    path.write_bytes(b"not a bag at all")
    with pytest.raises(InputError, match="is not a readable ROS bag"):
        read_bag(path, WHEELS)
    with pytest.raises(InputError, match="no such file"):
        read_bag(tmp_path / "none.bag", WHEELS)


def test_without_the_extra_one_sentence_says_how_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(InputError) as error:
        read_bag(tmp_path / "a.bag", WHEELS)
    assert str(error.value).endswith(
        "reading ROS bags needs the rosbags library; install it with: pip install 'gyrocal[ros]'."
    )


def test_replay_takes_a_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(navigation, "draw_figures", lambda replays, table: [])
    path = write_bag(tmp_path / "run", "mcap", IMU_ODOMETRY, last_s=40.0)
    (tmp_path / "robot.toml").write_text(f"wheel_separation_m = {SEPARATION_M}\nstatic_s = 0\n")
    request = ReplayRequest([path], tmp_path / "robot.toml", tmp_path / "out")
    result = replay_to_directory(request, lambda share, what: None)
    (log,) = result.summary["logs"]
    assert log["log"] == "run"
    assert log["direction"] == "ccw"
    rows = (tmp_path / "out" / "trajectories" / "run.csv").read_text().splitlines()
    last = dict(zip(rows[0].split(","), map(float, rows[-1].split(",")), strict=True))
    # The dead-reckoned frame starts where the bag's first gyro row is, along the robot.
    radius, turned = SPEED_MPS / TURN_RADPS, TURN_RADPS * log["duration_s"]
    assert last["uncalibrated_x_m"] == pytest.approx(radius * np.sin(turned), abs=0.05)
    assert last["uncalibrated_y_m"] == pytest.approx(radius * (1 - np.cos(turned)), abs=0.05)


@pytest.mark.parametrize(
    ("wheels", "message"),
    [
        ("nav_msgs/msg/Odometry", "the topic of wheels holds no message. Check what was recorded."),
        ("sensor_msgs/msg/JointState", "a JointState has 2 joints and 0 positions; wheel angles are needed."),
    ],
)
def test_a_topic_that_tells_nothing_of_the_wheels_is_refused(
    tmp_path: Path, wheels: str, message: str
) -> None:
    m = Messages(STORE1, True)
    types = {"/imu": "sensor_msgs/msg/Imu", "/wheels": wheels}
    with Writer1(tmp_path / "a.bag") as writer:
        connections = {t: writer.add_connection(t, kind, typestore=STORE1) for t, kind in types.items()}
        messages = {"/imu": m.imu(1.0)}
        if "JointState" in wheels:
            messages["/wheels"] = m.joints(1.0, ("left", "right"))
            messages["/wheels"].position = np.array([])
        for topic, value in messages.items():
            writer.write(connections[topic], 10**9, STORE1.serialize_ros1(value, types[topic]))
    with pytest.raises(InputError, match=message):
        read_bag(tmp_path / "a.bag", WHEELS)
