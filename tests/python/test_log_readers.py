"""Independent readers decode a flight log: the mcap package with the schemas in the file, and pymavlink the tlog.

Without an argument the log is a made-up flight whose every number is known. VIGIL_LOG=FILE.mcap checks any other log,
as far as its numbers need not be known.
"""

import importlib.util
import io
import json
import math
import os
import struct
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from unittest.mock import MagicMock

import pytest

pytest.importorskip("mcap", reason="runs in the environment of requirements-log.txt")

from mcap.exceptions import EndOfFile  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
from mcap.records import Message  # noqa: E402
from mcap.stream_reader import StreamReader  # noqa: E402
from mcap_protobuf.decoder import DecoderFactory  # noqa: E402
from pymavlink import mavutil  # noqa: E402
from pyulog import ULog  # noqa: E402
from stack import VIGIL  # noqa: E402

TOP = Path(__file__).resolve().parents[2]
ROWS, COLS = 128, 256
SCHEMAS = {
    "/depth": "foxglove.RawImage",
    "/depth/range": "foxglove.RawImage",
    "/tf": "foxglove.FrameTransform",
    "/pose": "foxglove.PoseInFrame",
    "/path": "foxglove.PosesInFrame",
    "/goal": "foxglove.PoseInFrame",
    "/scene": "foxglove.SceneUpdate",
    "/scene/points": "foxglove.PointCloud",
    "/log": "foxglove.Log",
    "/status": "vigil.log.Status",
    "/vigil/tick": "vigil.log.Tick",
    # Of simulated flights, added afterwards.
    "/truth/pose": "foxglove.PoseInFrame",
    "/attack": "vigil.log.Attack",
    "/depth/clean": "foxglove.RawImage",
    # Derived by replay.
    "/map/grid": "foxglove.Grid",
    "/map/way": "foxglove.PosesInFrame",
    "/shap": "foxglove.RawImage",
}
STEPS = 240
EPOCH_NS = 1_767_323_045_000_000_000
STEP_NS = 50_000_000


@pytest.fixture(scope="module")
def sample_path(tmp_path_factory):
    """A log of the made-up flight; its formulas are in firmware/log/examples/sample_log.rs."""
    directory = tmp_path_factory.mktemp("log")
    program = TOP / "target" / "release" / "examples" / "sample_log"
    assert program.is_file(), "build it: cargo build --release --workspace --example sample_log"
    out = subprocess.run([program, str(directory)], check=True, capture_output=True, text=True)
    return Path(out.stdout.strip())


@pytest.fixture(scope="module")
def any_path(request):
    given = os.environ.get("VIGIL_LOG")
    return Path(given) if given else request.getfixturevalue("sample_path")


def read(path):
    """Per topic, all messages as (MCAP message, decoded message)."""
    topics = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert SCHEMAS[channel.topic] == schema.name
            topics[channel.topic].append((message, decoded))
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        statistics = reader.get_summary().statistics
    return topics, metadata, statistics


def mavlink_packets(tlog):
    """Packets and bad bytes of a tlog as pymavlink reads it, with their times."""
    log = mavutil.mavlink_connection(str(tlog))
    while (message := log.recv_match()) is not None:
        yield log.timestamp, message


def test_any_log_is_decoded_by_the_schemas_it_carries(any_path):
    topics, metadata, statistics = read(any_path)
    ticks = topics["/vigil/tick"]
    assert int(metadata["vigil.end"]["records"]) == len(ticks) == len(topics["/status"])
    assert statistics.message_count == sum(map(len, topics.values()))
    assert metadata["vigil"]["format"] == "1"
    with_frame = [tick for _, tick in ticks if tick.HasField("frame")]
    assert len(with_frame) == len(topics["/depth"]) > 0
    for tick, (_, image) in zip(with_frame, topics["/depth"]):
        assert (image.width, image.height, image.step, image.encoding) == (COLS, ROWS, 4 * COLS, "32FC1")
        assert len(image.data) == 4 * ROWS * COLS
        assert (tick.frame.rows, tick.frame.cols) == (ROWS, COLS)
    for _, pose in topics["/pose"]:
        q = pose.pose.orientation
        assert math.isclose(q.w**2 + q.x**2 + q.y**2 + q.z**2, 1, abs_tol=0.05)
    # Also of what the simulation or a replay added.
    for message, decoded in (pair for pairs in topics.values() for pair in pairs):
        assert not hasattr(decoded, "timestamp") or decoded.timestamp.ToNanoseconds() == message.log_time


def test_any_tlog_holds_the_packets_of_the_log(any_path):
    topics, metadata, _ = read(any_path)
    offset = int(metadata["vigil"]["epoch_offset_ns"])
    datagrams = b"".join(d.data for _, tick in topics["/vigil/tick"] for d in [*tick.received, *tick.sent])
    packets = 0
    last = 0
    for time, message in mavlink_packets(any_path.with_suffix(".tlog")):
        assert bytes(message.get_msgbuf()) in datagrams
        assert time >= last
        last = time
        packets += message.get_type() != "BAD_DATA"
    first = topics["/vigil/tick"][0][1]
    assert packets > len(topics["/vigil/tick"])
    assert last >= (first.now_ns + offset) / 1e9 - 1e-3


def test_the_depth_images_bits_are_the_frames(sample_path):
    images = read(sample_path)[0]["/depth"]
    assert len(images) == STEPS // 2
    for n, (message, image) in enumerate(images):
        step = 2 * n
        expected = struct.pack(f"<{ROWS * COLS}f", *(((i + step) % 1000) / 1000 for i in range(ROWS * COLS)))
        assert image.data == expected
        assert message.sequence == step
        assert message.log_time == EPOCH_NS + step * STEP_NS
        assert image.timestamp.ToNanoseconds() == message.log_time


def test_poses_are_in_a_z_up_map(sample_path):
    topics = read(sample_path)[0]
    of_body = [tf for tf in topics["/tf"] if tf[1].child_frame_id == "base_link"]
    assert len(topics["/pose"]) == len(of_body) == STEPS
    for step, ((_, pose), (_, tf)) in enumerate(zip(topics["/pose"], of_body)):
        p, q = pose.pose.position, pose.pose.orientation
        assert (p.x, p.z) == (0.5, 1.5) and math.isclose(p.y, 0.1 * step, rel_tol=1e-6, abs_tol=1e-9)
        # Heading east with x pointing east: no turn.
        assert math.isclose(abs(q.w), 1, rel_tol=1e-6)
        assert (tf.parent_frame_id, tf.child_frame_id) == (pose.frame_id, "base_link")
        assert tf.translation.x == p.x and tf.rotation.w == q.w
    goal = topics["/goal"][0][1].pose.position
    assert (goal.x, goal.y, goal.z) == (5, 20, 1.5)
    path = topics["/path"][-1][1].poses
    assert path[0].position.y == 0 and path[-1].position.y > 20 and len(path) > 50


def test_every_frame_of_reference_leads_to_the_map(any_path):
    topics = read(any_path)[0]
    parents = {tf.child_frame_id: tf.parent_frame_id for _, tf in topics["/tf"]}
    used = {m.frame_id for t in topics if t not in ("/tf", "/scene") for _, m in topics[t] if hasattr(m, "frame_id")}
    assert {"map", "depth_sensor"} <= used
    for frame in used:
        seen = [frame]
        while seen[-1] != "map":
            assert seen[-1] in parents, f"{frame} hangs in the air: {seen}"
            seen.append(parents[seen[-1]])
            assert len(seen) < 10
    # It is there from the first second on.
    first = min(message.log_time for message, _ in topics["/vigil/tick"])
    for child in ("base_link", "depth_sensor"):
        times = [message.log_time for message, tf in topics["/tf"] if tf.child_frame_id == child]
        assert min(times) <= first + 1_000_000_000


def test_the_image_for_people_is_in_millimetres(sample_path):
    topics = read(sample_path)[0]
    exact = {message.sequence: image for message, image in topics["/depth"]}
    images = topics["/depth/range"]
    assert 50 <= len(images) <= 70, "five a second for 12 s"
    for message, image in images:
        assert (image.width, image.height, image.encoding, image.step) == (COLS // 2, ROWS // 2, "16UC1", COLS)
        metres = struct.unpack(f"<{ROWS * COLS}f", exact[message.sequence].data)
        for row, col in ((0, 0), (7, 30), (63, 127)):
            (seen,) = struct.unpack_from("<H", image.data, row * image.step + 2 * col)
            assert abs(seen - min(100_000 * metres[2 * row * COLS + 2 * col], 65_535)) <= 1


def test_every_panel_of_the_layout_for_foxglove_has_its_channel_and_field(any_path):
    layout = json.loads((TOP / "tools" / "assets" / "viewers" / "foxglove-layout.json").read_text())
    topics = read(any_path)[0]
    panels = layout["configById"]
    placed = set()

    def place(node):
        if isinstance(node, str):
            placed.add(node)
        else:
            place(node["first"])
            place(node["second"])

    place(layout["layout"])
    assert placed == set(panels)
    named = set()
    for name, panel in panels.items():
        named |= {t for t, shown in panel.get("topics", {}).items() if shown.get("visible", True)}
        named |= {panel["imageMode"]["imageTopic"]} if "imageMode" in panel else set()
        named |= {panel["topicToRender"]} if "topicToRender" in panel else set()
        for path in panel.get("paths", []):
            topic, field = path["value"].split(".")
            named.add(topic)
            assert hasattr(topics[topic][0][1], field), f"{name}: {path['value']}"
    for topic in named:
        assert topics[topic], f"no message on {topic}"
    assert {"/depth/range", "/status", "/log", "/scene", "/pose", "/path"} <= named


def test_the_scene_stands_where_the_solids_are(sample_path):
    topics = read(sample_path)[0]
    ((_, scene),) = topics["/scene"]
    (entity,) = scene.entities
    (cube,), (cylinder,) = entity.cubes, entity.cylinders
    assert (cube.pose.position.x, cube.pose.position.y, cube.pose.position.z) == (-2, 8, 1.5)
    assert (cube.size.y, cube.size.z) == (6, 3)
    turn = 2 * math.atan2(cube.pose.orientation.z, cube.pose.orientation.w)
    assert math.isclose(turn, math.pi / 2 - 0.4, rel_tol=1e-6)
    assert (cylinder.pose.position.x, cylinder.size.z) == (3, 4)
    ((_, cloud),) = topics["/scene/points"]
    assert [(f.name, f.offset) for f in cloud.fields] == [("x", 0), ("y", 4), ("z", 8)] and cloud.point_stride == 12
    points = list(struct.iter_unpack("<3f", cloud.data))
    on_cylinder = [p for p in points if math.isclose(math.hypot(p[0] - 3, p[1] - 12), 0.4, rel_tol=1e-5)]
    assert len(points) > 500 and len(on_cylinder) > 100
    assert all(-1e-6 <= z <= 4.000001 for _, _, z in points)


def test_ticks_and_status_tell_the_flight(sample_path):
    topics, metadata, _ = read(sample_path)
    assert metadata["vigil"]["config"] == "goal = [20.0, 5.0, 1.5]\n"
    assert (metadata["vigil"]["seed"], metadata["vigil"]["instance"]) == ("42", "2")
    for step, ((_, tick), (_, status)) in enumerate(zip(topics["/vigil/tick"], topics["/status"])):
        guided = 20 <= step < 220
        assert (tick.now_ns, tick.timing.step, status.step) == (step * STEP_NS, step, step)
        assert tick.report.HasField("setpoint") == guided
        assert math.isnan(status.setpoint_forward_m_s) != guided
        assert status.state == ("ready" if step < 20 else "guided" if guided else "hold")
        assert status.reasons == ("" if step < 220 else "goal reached")
        assert tick.report.telemetry.kinematics.position_ned_m.z == -1.5
        if guided:
            assert tick.report.setpoint.yaw_rate_rad_s == -0.125
            assert math.isclose(status.setpoint_yaw_rate_deg_s, math.degrees(-0.125))
    lines = [line.message for _, line in topics["/log"]]
    assert "guidance: ready → guided" in lines and "guidance: guided → hold (goal reached)" in lines


def test_mavlogdump_reads_the_tlog(sample_path):
    tlog = sample_path.with_suffix(".tlog")
    counts = defaultdict(int)
    for time, message in mavlink_packets(tlog):
        counts[message.get_type()] += 1
        if message.get_type() == "LOCAL_POSITION_NED":
            assert math.isclose(time, EPOCH_NS / 1e9 + message.time_boot_ms / 1e3, abs_tol=1e-4)
            assert math.isclose(message.x, message.time_boot_ms / 500, rel_tol=1e-6)
    # One packet of every fiftieth step has a wrong checksum; it disturbs none of the others.
    assert counts["HEARTBEAT"] == counts["LOCAL_POSITION_NED"] == STEPS
    assert counts["SET_POSITION_TARGET_LOCAL_NED"] == STEPS
    assert counts["BAD_DATA"] == 5
    # The tool itself, not only its library.
    tool = Path(sys.executable).with_name("mavlogdump.py")
    command = [sys.executable, tool, "--types", "HEARTBEAT", tlog]
    out = subprocess.run(command, env={**os.environ, "TZ": "UTC"}, check=True, capture_output=True, text=True)
    assert len(out.stdout.splitlines()) == STEPS
    assert out.stdout.startswith("2026-01-02")


def test_pyulog_reads_the_flight_as_ulog_with_px4s_topics_and_every_known_number(sample_path, tmp_path):
    ulg = tmp_path / "flight.ulg"
    done = subprocess.run([VIGIL, "log", "ulg", sample_path, "-o", ulg], check=True, capture_output=True, text=True)
    assert f"{STEPS} records" in done.stdout and "not all" not in done.stdout
    log = ULog(str(ulg))
    assert not log.file_corruption and log.msg_info_dict["sys_name"] == "Vigil"
    topics = {data.name: data.data for data in log.data_list}
    assert {"vehicle_local_position", "vehicle_attitude", "vehicle_status", "vehicle_local_position_setpoint", "vigil_status"} <= set(topics)
    stamps = [step * STEP_NS // 1000 for step in range(STEPS)]
    place = topics["vehicle_local_position"]
    assert place["timestamp"].tolist() == stamps
    assert place["x"] == pytest.approx([0.1 * step for step in range(STEPS)], rel=1e-6)
    assert set(place["y"]) == {0.5} and set(place["z"]) == {-1.5} and all(place["xy_valid"])
    assert place["heading"] == pytest.approx([math.pi / 2] * STEPS, abs=1e-6)
    # Facing east: forward is east.
    setpoint, guided = topics["vehicle_local_position_setpoint"], read(sample_path)[0]["/status"][20][1]
    assert setpoint["timestamp"].tolist() == stamps[20:220] and set(setpoint["yawspeed"]) == {-0.125}
    assert setpoint["vy"][0] == pytest.approx(guided.setpoint_forward_m_s) and abs(setpoint["vx"][0]) < 1e-6
    assert set(topics["vehicle_status"]["vehicle_type"]) == {1}
    status = topics["vigil_status"]
    assert status["step"].tolist() == list(range(STEPS))
    assert [math.isnan(x) for x in status["action_yaw"][18:22]] == [True, True, False, False]
    told = [message.message for message in log.logged_messages]
    assert "guidance: ready → guided" in told and "guidance: guided → hold (goal reached)" in told


def test_a_log_that_is_cut_or_none_becomes_as_much_of_a_ulog_as_is_whole_or_is_refused(sample_path, tmp_path):
    cut, ulg = tmp_path / "cut.mcap", tmp_path / "cut.ulg"
    whole = sample_path.read_bytes()
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    done = subprocess.run([VIGIL, "log", "ulg", cut], check=True, capture_output=True, text=True)
    assert "it is not all of the flight: the log was not closed" in done.stdout
    steps = {data.name: data.data for data in ULog(str(ulg)).data_list}["vigil_status"]["step"].tolist()
    assert 20 < len(steps) < STEPS and steps == list(range(len(steps)))
    done = subprocess.run([VIGIL, "log", "ulg", ulg], check=False, capture_output=True, text=True)
    assert done.returncode == 1 and "cut.ulg is no MCAP file but a ULog of PX4" in done.stderr


def test_a_cut_log_is_read_as_far_as_it_goes(sample_path, tmp_path):
    whole = sample_path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    messages = 0
    with cut.open("rb") as file, pytest.raises(EndOfFile):
        for record in StreamReader(file).records:
            messages += isinstance(record, Message)
    assert messages > 500


@pytest.fixture
def view(monkeypatch):
    """The viewer's script with a stand-in for the viewer that notes what it is handed: reading and drawing run as they are."""
    rerun, blueprint = MagicMock(), MagicMock()
    rerun.blueprint = blueprint
    monkeypatch.setitem(sys.modules, "rerun", rerun)
    monkeypatch.setitem(sys.modules, "rerun.blueprint", blueprint)
    script = TOP / "tools" / "assets" / "viewers" / "rerun_view.py"
    spec = importlib.util.spec_from_file_location("rerun_view", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def origins_of(blueprint):
    return {call.kwargs["origin"].strip("/") for call in blueprint.method_calls if "origin" in call.kwargs}


def test_the_view_in_rerun_draws_the_whole_flight_of_any_log(any_path, view):
    rerun, blueprint = view.rr, view.rrb
    show = view.Show()
    with any_path.open("rb") as file:
        assert view.read(file, show) is None, "read to its end"
    assert view.NEEDED <= show.seen
    drawn = {call.args[0] for call in rerun.log.call_args_list}
    assert {"map/base_link", "map/path", "map/goal", "map/base_link/depth_sensor/range", "map/base_link/returns", "log"} <= drawn
    assert {"map/scene/boxes", "map/scene/cylinders"} & drawn
    # Whatever the layout places is drawn, and every plot has its field.
    view.layout()
    status = read(any_path)[0]["/status"][0][1]
    for path, series in view.PLOTS.items():
        assert any(f"{path}/{field}" in drawn for field, _, _ in series), path
        assert all(hasattr(status, field) for field, _, _ in series)
    origins = origins_of(blueprint)
    assert origins == {"map", "log", "map/base_link/depth_sensor", "plots/attack", *view.PLOTS}
    for origin in origins - {"plots/attack"}:
        assert any(path == origin or path.startswith(origin + "/") for path in drawn), f"nothing is drawn in {origin}"

    # One that was cut off is shown up to there.
    short = io.BytesIO(any_path.read_bytes()[: any_path.stat().st_size // 2])
    half = view.Show()
    assert view.read(short, half) is not None
    assert "/status" in half.seen


def test_the_view_in_rerun_shows_a_damaged_log_up_to_the_damage(sample_path, view):
    damaged = bytearray(sample_path.read_bytes())
    damaged[len(damaged) // 2] ^= 0x10
    show = view.Show()
    assert view.read(io.BytesIO(damaged), show)
    assert "/status" in show.seen


def test_of_several_logs_in_a_folder_the_newest_is_followed(view, tmp_path):
    for name, modified_s in (("flight-0001", 1), ("flight-0003", 3), ("flight-0002", 2)):
        log = tmp_path / f"{name}.mcap"
        log.touch()
        os.utime(log, (modified_s, modified_s))
    assert view.wait_for(tmp_path).name == "flight-0003.mcap"


def test_a_log_that_lacks_a_channel_leaves_its_part_of_the_view_empty_and_that_is_noticed(any_path, view):
    parts = {
        "/tf": "map/base_link", "/scene": "map/scene/boxes", "/log": "log", "/status": "plots/step/step_time_ms",
        "/depth/range": "map/base_link/depth_sensor/range",
    }
    everything = view.CHANNELS
    for missing, part in parts.items():
        view.rr.reset_mock()
        view.CHANNELS = everything - {missing}
        show = view.Show()
        with any_path.open("rb") as file:
            assert view.read(file, show) is None
        assert view.NEEDED - show.seen == {missing}
        # The names and colours of plots stand there without a value, too.
        drawn = {c.args[0] for c in view.rr.log.call_args_list if not (c.kwargs["static"] and c.args[0].startswith("plots/"))}
        assert part not in drawn and set(parts.values()) - {part} <= drawn


def test_several_flights_are_drawn_side_by_side_each_below_its_own_name(any_path, view, tmp_path):
    names = ["7", "8"]
    for name in names:
        (tmp_path / f"{name}.mcap").symlink_to(any_path)
    view.layout(names)
    view.follow_all(tmp_path, names)
    drawn = {call.args[0] for call in view.rr.log.call_args_list}
    origins = origins_of(view.rrb)
    for name in names:
        assert f"{name}/map/base_link" in drawn
        for path in ("map", "log", "map/base_link/depth_sensor", *view.PLOTS):
            assert f"{name}/{path}" in origins
            assert any(d == f"{name}/{path}" or d.startswith(f"{name}/{path}/") for d in drawn), path
    assert all(path.startswith(("7/", "8/")) for path in drawn)


def test_a_course_is_drawn_with_what_stands_and_what_moves(view):
    box = {"cuboid": {"centre_ned_m": [8, -2, -1.5], "half_extents_m": [2, 0.1, 1.5], "yaw_rad": 0.3}}
    column = {"cylinder": {"centre_ned_m": [5, 1, -2], "radius_m": 0.4, "half_height_m": 2}}
    course = {
        "name": "mine", "family": None, "seed": 0, "start_ned_m": [0, 0, 0], "heading_rad": 0, "goal_ned_m": [20, 5, -1.5],
        "goal_radius_m": 1, "time_limit_s": 90, "bounds": {"north_m": [-2, 22], "east_m": [-8, 8], "top_m": 4}, "ceiling_height_m": None,
        "way_ne_m": [[0, 0], [20, 5]], "solids": [box, column], "movers": [{"solids": [column]}] * 3, "movers_step_s": 0.2,
        "depth_mm": [[1000] * 128] * 64,
    }
    view.course_layout()
    view.show_course(course)
    drawn = [call.args[0] for call in view.rr.log.call_args_list]
    assert {"map/still/boxes", "map/still/cylinders", "map/goal", "map/bounds", "map/way", "map/start/depth", "about"} <= set(drawn)
    assert drawn.count("map/moving/cylinders") == 3
    for origin in origins_of(view.rrb):
        assert any(path == origin or path.startswith(origin + "/") for path in drawn), origin
    (boxes,) = [call.kwargs for call in view.rr.Boxes3D.call_args_list if "centers" in call.kwargs]
    # x east, y north, z up.
    assert boxes["centers"] == [[-2, 8, 1.5]]
    # Without a way the page says so.
    view.show_course({**course, "way_ne_m": None, "movers": []})
    assert "no way" in view.rr.TextDocument.call_args.args[0]
