"""Shows a Vigil flight log in the Rerun viewer, in a ready layout.

Rerun reads MCAP itself, but draws neither scenes, planned paths nor grids of it, and has no layout for it. This script reads the log by
the schemas that it carries and hands the viewer what it draws: `vigil view LOG` runs it.

Usage: rerun_view.py LOG [--follow] [--port PORT] [--save FILE.rrd] [--layout FILE.rbl]
       rerun_view.py FOLDER --flights NAME,NAME,...     logs that come to be there, each in a tab of its own
       rerun_view.py --course FILE.json                 a course alone
Packages: rerun-sdk, mcap, mcap-protobuf-support and numpy, in the versions that `vigil view` names.
"""

import argparse
import json
import math
import os
import shlex
import signal
import struct
import sys
import threading
import time
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Channel, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

FORMAT = "1"
# What is raised of a damaged piece: what unpacks LZ4 has RuntimeError, a wrong length OverflowError or struct.error.
DAMAGE = (McapError, DecodeError, RuntimeError, ValueError, OSError, OverflowError, MemoryError, struct.error)
# Rows and columns of a frame, its fields of view, the range of a pixel of 1.
ROWS, COLS = 128, 256
WIDTH_RAD, HEIGHT_RAD = math.radians(120), math.radians(60)
# What the layout draws. A test holds that a log has all of it.
CHANNELS = {
    "/tf", "/pose", "/path", "/goal", "/scene", "/log", "/status", "/depth/range", "/map/grid", "/map/way", "/shap", "/truth/pose",
    "/attack", "/depth/clean",
}
# Without these the view is empty; the others depend on the flight.
NEEDED = {"/tf", "/pose", "/scene", "/log", "/status", "/depth/range"}
# Safe for the colour-blind: Okabe and Ito.
BLUE, ORANGE, GREEN, RED, PINK, GREY = (
    (0, 114, 178), (230, 159, 0), (0, 158, 115), (213, 94, 0), (204, 121, 167), (150, 150, 150),
)
# Topic of a plot -> fields of /status, names, colours.
PLOTS = {
    "plots/score": (("detector_score", "score", BLUE), ("detector_threshold", "threshold", RED)),
    "plots/yaw": (("actor_yaw", "what the actor wanted", ORANGE), ("action_yaw", "what was flown", BLUE)),
    "plots/cause": (
        ("contribution_image", "picture", BLUE), ("contribution_bearing", "bearing", ORANGE), ("contribution_distance", "distance", GREEN),
        ("contribution_told", "own motion", RED),
    ),
    "plots/speed": (("speed_m_s", "speed, m/s", BLUE), ("setpoint_forward_m_s", "setpoint forward, m/s", ORANGE)),
    "plots/step": (("step_time_ms", "time of a step, ms", BLUE),),
    "plots/state": (("state_code", "state of guidance", BLUE), ("alarm_response", "response to the alarm", RED)),
}


def flight_view(prefix, name):
    """The flight in 3-D, without the pictures that its sensor took."""
    sensor = f"/{prefix}map/base_link/depth_sensor"
    return rrb.Spatial3DView(
        origin=f"/{prefix}map", name=name, contents=[f"/{prefix}map/**", f"- {sensor}/range", f"- {sensor}/shap"],
    )


def panels(prefix="", name=None):
    """Everything of one flight."""
    plot = lambda name, path: rrb.TimeSeriesView(origin=f"/{prefix}{path}", name=name)
    return rrb.Horizontal(
        rrb.Vertical(
            flight_view(prefix, "Flight"),
            rrb.TextLogView(origin=f"/{prefix}log", name="Events: states, alarms and who raised them"),
            row_shares=[3, 1],
        ),
        rrb.Vertical(
            rrb.Spatial2DView(origin=f"/{prefix}map/base_link/depth_sensor", name="Depth in metres, SHAP over it (orange: turns right)"),
            plot("Detector: score against threshold", "plots/score"),
            plot("Yaw: wanted and flown", "plots/yaw"),
            plot("What moved the yaw", "plots/cause"),
            row_shares=[3, 2, 2, 2],
        ),
        rrb.Vertical(
            plot("Speed", "plots/speed"),
            plot("Step time", "plots/step"),
            plot("State and alarm", "plots/state"),
            plot("Altered frames: change of the actor's yaw", "plots/attack"),
        ),
        column_shares=[5, 3, 2],
        name=name,
    )


def blueprint(root):
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def layout(names=()):
    """Where everything stands; of several flights all side by side in the first tab, then a tab for each."""
    if not names:
        return blueprint(panels())
    both = lambda name: rrb.Vertical(
        flight_view(f"{name}/", name), rrb.TimeSeriesView(origin=f"/{name}/plots/score", name=f"{name}: score"), row_shares=[4, 1],
    )
    tabs = [panels(f"{name}/", name) for name in names]
    return blueprint(rrb.Tabs(rrb.Grid(*map(both, names), name="all flights"), *tabs))


def course_layout():
    """A course alone."""
    return blueprint(rrb.Horizontal(
        rrb.Spatial3DView(origin="/map", name="Course", contents=["/map/**", "- /map/start/depth"]),
        rrb.Vertical(
            rrb.Spatial2DView(origin="/map/start/depth", name="What the sensor sees at the start, metres"),
            rrb.TextDocumentView(origin="/about", name="Course"),
        ),
        column_shares=[3, 1],
    ))


class Growing:
    """A file that is still being written: a read waits for what is to come."""

    def __init__(self, file, patience_s=15.0):
        self.file, self.patience_s = file, patience_s

    def read(self, size=-1):
        parts, missing, last = [], size, time.monotonic()
        while missing > 0:
            part = self.file.read(missing)
            if part:
                parts.append(part)
                missing -= len(part)
                last = time.monotonic()
            elif time.monotonic() - last > self.patience_s:
                break
            else:
                time.sleep(0.02)
        return b"".join(parts)


def point(p):
    return [p.x, p.y, p.z]


def turn(q):
    return rr.Quaternion(xyzw=[q.x, q.y, q.z, q.w])


class Show:
    """Hands the viewer one message after the other; what it draws stands below `prefix`."""

    def __init__(self, prefix=""):
        self.prefix = prefix
        self.seen = set()
        self.shown_path = []
        self.first_ns = None
        self.flew = False

    def draw(self, path, what, static=False):
        rr.log(f"{self.prefix}{path}", what, static=static)

    def begin(self, metadata):
        if metadata.get("format") != FORMAT:
            sys.exit(f"the log has format {metadata.get('format')}, written by {metadata.get('program', 'an unknown program')}; "
                     f"this viewer script reads format {FORMAT}")
        self.draw("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self.draw("map/base_link/body", rr.Boxes3D(half_sizes=[[0.2, 0.2, 0.06]], colors=[BLUE], fill_mode="solid"), static=True)
        self.draw("map/base_link/nose", rr.Arrows3D(vectors=[[0.8, 0, 0]], colors=[BLUE]), static=True)
        self.draw("map/home", rr.Points3D([[0, 0, 0]], radii=0.1, colors=[GREY], labels=["home"]), static=True)
        for path, series in PLOTS.items():
            for field, name, colour in series:
                self.draw(f"{path}/{field}", rr.SeriesLines(names=[name], colors=[colour], widths=[1.5]), static=True)
        self.draw("plots/attack/yaw_change", rr.SeriesLines(names=["altered by"], colors=[RED]), static=True)

    def about(self, metadata):
        lines = "\n".join(f"- **{key}**: {value}" for key, value in sorted(metadata.items()))
        self.draw("about", rr.TextDocument(lines, media_type="text/markdown"), static=True)

    def message(self, topic, message, decoded):
        self.seen.add(topic)
        self.first_ns = self.first_ns or message.log_time
        rr.set_time("flight", duration=max(0, message.log_time - self.first_ns) / 1e9)
        show = getattr(self, topic.strip("/").replace("/", "_"), None)
        if show:
            show(decoded)

    def tf(self, tf):
        # Columns of a frame are angles, not a pinhole's: the frame is drawn as rays, and as a picture of its own.
        at = {"base_link": "map/base_link", "base_link_true": "map/truth"}.get(tf.child_frame_id)
        if at:
            self.draw(at, rr.Transform3D(translation=point(tf.translation), quaternion=turn(tf.rotation)))

    def path(self, path):
        self.draw("map/path", rr.LineStrips3D([[point(p.position) for p in path.poses]], colors=[BLUE], radii=[0.04]))

    def goal(self, goal):
        self.draw("map/goal", rr.Points3D([point(goal.pose.position)], radii=0.3, colors=[GREEN], labels=["goal"]))

    def scene(self, update):
        for entity in update.entities:
            cubes, cylinders = entity.cubes, entity.cylinders
            if cubes:
                self.draw("map/scene/boxes", rr.Boxes3D(
                    centers=[point(c.pose.position) for c in cubes],
                    half_sizes=[[c.size.x / 2, c.size.y / 2, c.size.z / 2] for c in cubes],
                    quaternions=[turn(c.pose.orientation) for c in cubes], colors=[GREY], fill_mode="solid"), static=True)
            if cylinders:
                self.draw("map/scene/cylinders", rr.Cylinders3D(
                    lengths=[c.size.z for c in cylinders], radii=[c.size.x / 2 for c in cylinders],
                    centers=[point(c.pose.position) for c in cylinders],
                    quaternions=[turn(c.pose.orientation) for c in cylinders], colors=[GREY], fill_mode="solid"), static=True)

    def depth_range(self, image):
        metres = np.frombuffer(image.data, "<u2").reshape(image.height, image.width) / np.float32(1000)
        self.draw("map/base_link/depth_sensor/range", rr.DepthImage(metres, meter=1.0, colormap="viridis", depth_range=[0, 12]))
        rows, cols = (at[::4] for at in np.nonzero((metres > 0) & (metres < 20)))
        bearing = ((cols + 0.5) / image.width - 0.5) * WIDTH_RAD
        elevation = (0.5 - (rows + 0.5) / image.height) * HEIGHT_RAD
        r = metres[rows, cols]
        points = np.stack([r * np.cos(elevation) * np.cos(bearing), -r * np.cos(elevation) * np.sin(bearing), r * np.sin(elevation)], axis=1)
        self.draw("map/base_link/returns", rr.Points3D(points, radii=0.03, colors=[ORANGE]))

    def depth_clean(self, image):
        metres = np.frombuffer(image.data, "<f4").reshape(image.height, image.width) * 100
        self.draw("clean", rr.DepthImage(metres, meter=1.0, colormap="viridis", depth_range=[0, 12]))

    def shap(self, image):
        sums = np.frombuffer(image.data, "<f4").reshape(image.height, image.width)
        full = max(float(np.quantile(np.abs(sums), 0.99)), 1e-9)
        share = np.clip(sums / full, -1, 1)
        rgba = np.zeros((*sums.shape, 4), np.uint8)
        rgba[share >= 0, :3] = (255, 140, 0)
        rgba[share < 0, :3] = (80, 170, 255)
        rgba[..., 3] = 220 * np.sqrt(np.abs(share))
        factor = COLS // 2 // image.width
        rgba = rgba.repeat(factor, axis=0).repeat(factor, axis=1)
        self.draw("map/base_link/depth_sensor/shap", rr.Image(rgba, draw_order=10))

    def map_grid(self, grid):
        percent = np.frombuffer(grid.data, np.uint8).reshape(-1, grid.row_stride)[:, : grid.column_count]
        rows, cols = np.nonzero(percent >= 33)
        corner, cell = grid.pose.position, grid.cell_size
        centres = np.stack([corner.x + (cols + 0.5) * cell.x, corner.y + (rows + 0.5) * cell.y, np.full(len(rows), 0.03)], axis=1)
        self.draw("map/grid", rr.Boxes3D(centers=centres, half_sizes=[[cell.x / 2, cell.y / 2, 0.02]], colors=[PINK], fill_mode="solid"))

    def map_way(self, way):
        self.draw("map/way", rr.LineStrips3D([[point(p.position) for p in way.poses]], colors=[PINK], radii=[0.06]))

    def truth_pose(self, truth):
        self.shown_path.append(point(truth.pose.position))
        thinned = self.shown_path[:: 1 + len(self.shown_path) // 600]
        self.draw("map/true_path", rr.LineStrips3D([[*thinned, self.shown_path[-1]]], colors=[GREEN], radii=[0.02]))

    def attack(self, attack):
        self.draw("plots/attack/yaw_change", rr.Scalars(abs(attack.yaw_change) if attack.altered > 0.5 else 0.0))

    def log(self, line):
        level = {3: "WARN", 4: "ERROR", 5: "CRITICAL"}.get(line.level, "INFO")
        self.draw("log", rr.TextLog(line.message, level=level))

    def status(self, status):
        self.flew = self.flew or status.state == "guided" or status.height_m > 0.5
        for path, series in PLOTS.items():
            for field, _, _ in series:
                value = getattr(status, field)
                if not math.isnan(value):
                    self.draw(f"{path}/{field}", rr.Scalars(value))


def read(file, show):
    """Hands all messages on; returns why the log ends early, if it does."""
    decoders, schemas, channels = DecoderFactory(), {}, {}
    try:
        for record in StreamReader(file, record_size_limit=None).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                schema = schemas.get(record.schema_id)
                wanted = schema and record.topic in CHANNELS
                channels[record.id] = (record.topic, decoders.decoder_for(record.message_encoding, schema)) if wanted else None
            elif isinstance(record, Metadata) and record.name == "vigil":
                show.begin(record.metadata)
            elif isinstance(record, Metadata) and record.name == "vigil.flight":
                show.about(record.metadata)
            elif isinstance(record, Message) and channels.get(record.channel_id):
                topic, decode = channels[record.channel_id]
                show.message(topic, record, decode(record.data))
            elif isinstance(record, DataEnd):
                return None
    except DAMAGE as error:
        return f"{type(error).__name__}: {error}".rstrip(": ")
    return "no end"


def follow_all(folder, names):
    """Shows the logs that come to be in a folder, all at once, until each has ended or is not waited for any more."""
    no_more, parent = threading.Event(), os.getppid()
    signal.signal(signal.SIGTERM, lambda *_: no_more.set())

    def follow(name):
        path = folder / f"{name}.mcap"
        while not path.exists():
            if no_more.is_set() or os.getppid() != parent:
                return
            time.sleep(0.1)
        with path.open("rb") as file:
            read(Growing(file), Show(f"{name}/"))

    threads = [threading.Thread(target=follow, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        # With a limit, so that the signal is seen.
        while thread.is_alive():
            thread.join(0.2)


def in_map(ned):
    """Viewers draw with z up: x east, y north."""
    north, east, down = ned
    return [east, north, -down]


def draw_solids(at, solids, colour, static):
    boxes = [s["cuboid"] for s in solids if "cuboid" in s]
    cylinders = [s["cylinder"] for s in solids if "cylinder" in s]
    if boxes:
        halves = [(math.pi / 2 - b["yaw_rad"]) / 2 for b in boxes]
        rr.log(f"{at}/boxes", rr.Boxes3D(
            centers=[in_map(b["centre_ned_m"]) for b in boxes], half_sizes=[b["half_extents_m"] for b in boxes],
            quaternions=[rr.Quaternion(xyzw=[0, 0, math.sin(a), math.cos(a)]) for a in halves], colors=[colour], fill_mode="solid"), static=static)
    if cylinders:
        rr.log(f"{at}/cylinders", rr.Cylinders3D(
            lengths=[2 * c["half_height_m"] for c in cylinders], radii=[c["radius_m"] for c in cylinders],
            centers=[in_map(c["centre_ned_m"]) for c in cylinders], colors=[colour], fill_mode="solid"), static=static)


def show_course(course):
    rr.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    draw_solids("map/still", course["solids"], GREY, True)
    start, goal, heading = course["start_ned_m"], course["goal_ned_m"], course["heading_rad"]
    rr.log("map/start", rr.Arrows3D(origins=[in_map(start)], vectors=[[1.5 * math.sin(heading), 1.5 * math.cos(heading), 0]], colors=[BLUE],
                                    labels=["start"]), static=True)
    rr.log("map/goal", rr.Ellipsoids3D(centers=[in_map(goal)], half_sizes=[[course["goal_radius_m"]] * 3], colors=[GREEN], labels=["goal"]),
           static=True)
    (south, north), (west, east), top = course["bounds"]["north_m"], course["bounds"]["east_m"], course["bounds"]["top_m"]
    rr.log("map/bounds", rr.Boxes3D(mins=[[west, south, 0]], sizes=[[east - west, north - south, top]], colors=[BLUE], fill_mode="majorwireframe"),
           static=True)
    if course["way_ne_m"]:
        height = -goal[2]
        rr.log("map/way", rr.LineStrips3D([[[e, n, height] for n, e in course["way_ne_m"]]], colors=[GREEN], radii=[0.04]), static=True)
    for step, movers in enumerate(course["movers"]):
        rr.set_time("course", duration=step * course["movers_step_s"])
        draw_solids("map/moving", movers["solids"], PINK, False)
    metres = np.array(course["depth_mm"], np.float32) / 1000
    rr.log("map/start/depth", rr.DepthImage(metres, meter=1.0, colormap="viridis", depth_range=[0, 12]), static=True)
    moving = len(course["movers"][0]["solids"]) if course["movers"] else 0
    family = f"family {course['family']}, seed {course['seed']}" if course["family"] else "made by hand"
    way = "green line: a way that keeps clear" if course["way_ne_m"] else "**no way from start to goal keeps clear of the obstacles**"
    # What is drawn of wires and meshes are pieces.
    still = ", ".join(f"{course[kind]} {kind}" for kind in ("obstacles", "wires", "meshes") if course.get(kind))
    lines = [f"# {course['name']}", family, f"standing still: {still or 'nothing'}", f"{moving} move (pink; press play)", way,
             f"goal reached within {course['goal_radius_m']:.1f} m, in {course['time_limit_s']:.0f} s"]
    rr.log("about", rr.TextDocument("\n\n".join(lines), media_type="text/markdown"), static=True)


def wait_for(path, patience_s=15.0):
    """The log, or the newest one in a folder, once it is there."""
    begun = time.monotonic()
    while time.monotonic() - begun < patience_s:
        logs = list(path.glob("*.mcap")) if path.is_dir() else [path] if path.exists() else []
        if logs:
            return max(logs, key=lambda log: log.stat().st_mtime)
        time.sleep(0.1)
    sys.exit(f"no log came to be in {path}")


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("log", nargs="?", help="a flight log (MCAP)")
    arguments.add_argument("--follow", action="store_true", help="the log is still being written")
    arguments.add_argument("--port", type=int, default=9876, help="of the viewer")
    arguments.add_argument("--save", help="write a recording for the viewer instead of opening it")
    arguments.add_argument("--layout", help="write the layout alone, as a blueprint file, and end")
    arguments.add_argument("--flights", help="names of logs that come to be in a folder, with commas between")
    arguments.add_argument("--course", help="a course (JSON)")
    args = arguments.parse_args()
    if args.layout:
        layout().save("vigil", args.layout)
        return
    if args.course:
        course = json.loads(Path(args.course).read_text())
        open_viewer(args, f"{course['name']}-{os.getpid()}", course_layout())
        show_course(course)
        rr.get_global_data_recording().flush()
        return
    if not args.log:
        arguments.error("which log?")
    path = Path(args.log)
    if args.follow or args.flights:
        # What is looked at must not take time from what flies.
        os.nice(10)
    if args.flights:
        names = args.flights.split(",")
        open_viewer(args, f"{path.name}-{os.getpid()}", layout(names))
        follow_all(path, names)
        rr.get_global_data_recording().flush()
        return
    if args.follow:
        path = wait_for(path)
    with path.open("rb") as file:
        if not args.follow and file.read(8) != b"\x89MCAP0\r\n":
            sys.exit(f"{path} is no MCAP file")
        file.seek(0)
        open_viewer(args, f"{path.parent.name}/{path.stem}-{os.getpid()}", layout())
        rr.send_recording_name(path.stem)
        show = Show()
        early = read(Growing(file) if args.follow else file, show)
        rr.get_global_data_recording().flush()
    if early and not args.follow:
        print(f"{path} was not closed or is damaged ({early}): what stands before is shown", file=sys.stderr)
    for topic in sorted(NEEDED - show.seen):
        print(f"{path} holds nothing on {topic}: that part of the view is empty", file=sys.stderr)
    if "/status" in show.seen and not show.flew:
        print(f"the vehicle never took off in {path}: obstacles and events are shown, `vigil log report` says why", file=sys.stderr)
    if not {"/map/grid", "/shap"} <= show.seen and not args.follow:
        print(f"map, planned path and SHAP: `vigil log derive {shlex.quote(str(path))}` puts them into the log", file=sys.stderr)


def open_viewer(args, recording, place):
    rr.init("vigil", recording_id=recording)
    if args.save:
        rr.save(args.save, default_blueprint=place)
    else:
        # The viewer's program lies beside this Python, which need not be on the path.
        os.environ["PATH"] = os.pathsep.join([os.path.dirname(sys.executable), os.environ.get("PATH", "")])
        rr.spawn(port=args.port, hide_welcome_screen=True, default_blueprint=place)


if __name__ == "__main__":
    try:
        main()
    except RuntimeError as error:
        sys.exit(f"rerun: {error}")
