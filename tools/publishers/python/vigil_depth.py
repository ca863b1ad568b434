"""Publishes depth frames to Vigil from Python: docs/sensor-interface.md is the interface.

    publisher = DepthPublisher(instance=0, sensor_id=1)
    publisher.publish(ranges_m, position_ned_m, attitude_wxyz)

Needs the packages `iceoryx2` 0.10 and `xxhash`; `numpy` for images; `blake3` where frames are authenticated.
"""

import ctypes
import errno
import operator
import os
import pathlib
import re
import struct
import time

import iceoryx2 as iox2
import numpy as np
import xxhash

ROWS, COLS = 128, 256
PIXELS = ROWS * COLS
FULL_SCALE_M = 100.0
#: What is less is 0 as a pixel.
LEAST_M = 1e-30
#: No depth sensor measures farther: what is, is of another unit.
FARTHEST_M = 1000.0
#: An estimate farther from the origin is none.
FARTHEST_PLACE_M = 100_000.0
LAST_INSTANCE = 99
#: How far a stamp may lie ahead of the clock: one step of the loop that reads the frames.
STEP_NS = 50_000_000
#: What was captured longer ago is used by nobody: such a stamp is of another clock.
OLDEST_NS = 1_000_000_000
#: What a publisher needs of shared memory (3.5 MiB), with a margin; without it the system kills the process.
NEEDED_BYTES = 4 << 20
#: Bytes of the header that checksum and tag cover.
COVERED = 56
KEY_CONTEXT = "Vigil depth frame authentication, version 1"


class DepthFrame(ctypes.Structure):
    """A frame as it lies in shared memory: 80 bytes of header, then 128 x 256 float32, row by row from the top left."""

    _fields_ = [
        ("stamp_ns", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("sensor_id", ctypes.c_uint32),
        ("rows", ctypes.c_uint16),
        ("cols", ctypes.c_uint16),
        ("position_ned_m", ctypes.c_float * 3),
        ("attitude_wxyz", ctypes.c_float * 4),
        ("reserved", ctypes.c_uint32),
        ("checksum", ctypes.c_uint64),
        ("tag", ctypes.c_uint8 * 16),
        ("depth", ctypes.c_float * PIXELS),
    ]

    @staticmethod
    def type_name() -> str:
        return "vigil_depth_frame_v2"


def seal(frame: DepthFrame, key: bytes | None = None) -> None:
    """Sets the checksum, and with a key the authentication tag: a publisher's last act."""
    whole = memoryview(frame).cast("B")
    header, pixels = whole[:COVERED], whole[ctypes.sizeof(DepthFrame) - 4 * PIXELS :]
    value = xxhash.xxh3_64_intdigest(header)
    for block in range(0, len(pixels), 4096):
        value = xxhash.xxh3_64_intdigest(pixels[block : block + 4096], seed=value)
    frame.checksum = value
    if key is not None:
        import blake3

        frame.tag[:] = blake3.blake3(bytes(header) + bytes(pixels), key=key).digest(16)


def frame_key(path: os.PathLike | str, sensor_id: int) -> bytes:
    """The key of a sensor in this boot of the machine, from the secret in a file (docs/frame-authentication.md)."""
    import blake3

    about = os.stat(path)
    if about.st_mode & 0o077 or about.st_uid not in (0, os.getuid()):
        raise ValueError(f"{path} is open to others: chown it to yourself and chmod 600 it")
    content = pathlib.Path(path).read_bytes()
    digits = re.fullmatch(rb"\s*([0-9a-fA-F]{64})\s*", content)
    secret = bytes.fromhex(digits[1].decode()) if digits else content
    if len(secret) != 32 or not any(secret):
        raise ValueError(f"{path} is not a key: it needs 32 bytes or 64 hexadecimal digits, not all zero")
    boot = pathlib.Path("/proc/sys/kernel/random/boot_id").read_bytes().strip()
    material = secret + struct.pack("<I", sensor_id) + boot
    return blake3.blake3(material, derive_key_context=KEY_CONTEXT).digest()


def real_numbers(values, what: str, shape: tuple[int, ...]) -> np.ndarray:
    """Values as float64 of this shape. Raises a ValueError for other shapes and for what is no real number: truth values, text,
    complex numbers, objects. What an array masks becomes NaN."""
    given = np.ma.asanyarray(values)
    if given.dtype.kind not in "fiu":
        raise ValueError(f"{what}: real numbers are needed, got an array of type {given.dtype}")
    if given.shape != shape:
        raise ValueError(f"{what}: the shape {shape} is needed, got {given.shape}")
    return np.asarray(np.ma.filled(given.astype(np.float64), np.nan))


def returns(ranges_m) -> tuple[np.ndarray, np.ndarray]:
    """Ranges as float64, metres, and where something returned. Raises a ValueError for an image that must not be published: no
    return reads as free space, so an image in which nothing returned, or one of another unit, would clear the way."""
    ranges_m = real_numbers(ranges_m, "ranges_m", (ROWS, COLS))
    finite = np.isfinite(ranges_m)
    farthest = np.max(ranges_m, where=finite, initial=0.0)
    if farthest > FARTHEST_M:
        raise ValueError(
            f"a range of {farthest:g}: ranges_m are metres (of millimetres, divide by 1000); where nothing returned, give infinity"
        )
    positive = ranges_m > LEAST_M
    hit = finite & positive & (ranges_m < FULL_SCALE_M)
    if not hit.any():
        raise ValueError(
            f"an image without a single range: {np.count_nonzero(~finite)} pixels are not finite, "
            f"{np.count_nonzero(finite & ~positive)} are 0 or less, {np.count_nonzero(finite & positive)} are 100 m "
            "or farther. Nothing was published, for it would read as free space: is the sensor covered, is the unit metres?"
        )
    return ranges_m, hit


def pose(position_ned_m, attitude_wxyz) -> tuple[np.ndarray, np.ndarray]:
    """A position and a quaternion that the firmware takes, as float32. Raises a ValueError for others."""
    with np.errstate(over="ignore"):
        position = real_numbers(position_ned_m, "position_ned_m", (3,)).astype(np.float32)
        attitude = real_numbers(attitude_wxyz, "attitude_wxyz", (4,)).astype(np.float32)
        unit = abs(float(attitude @ attitude) - 1.0) < 0.02
    if not (np.abs(position) <= FARTHEST_PLACE_M).all() or not unit:
        raise ValueError(
            f"position_ned_m {position.tolist()} must be finite, within 100 km, and attitude_wxyz {attitude.tolist()} of unit length"
        )
    return position, attitude


class DepthPublisher:
    """The one source of frames of an instance of Vigil. A second one is refused by iceoryx2."""

    def __init__(self, instance: int = 0, sensor_id: int = 1, key_file: os.PathLike | str | None = None):
        for name, value, last in (("instance", instance, LAST_INSTANCE), ("sensor_id", sensor_id, 2**32 - 1)):
            if isinstance(value, bool) or not 0 <= operator.index(value) <= last:
                raise ValueError(f"{name} {value}: must be from 0 to {last}")
        folder = pathlib.Path(f"/dev/shm/vigil-{os.getuid()}")
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.stat().st_mode & 0o077:
            raise PermissionError(f"{folder} must be closed to others: chmod 700 {folder}")
        about = os.statvfs(folder)
        if (free := about.f_bavail * about.f_frsize) < NEEDED_BYTES:
            raise OSError(errno.ENOSPC, f"{folder} has {free >> 10} KiB free, {NEEDED_BYTES >> 10} KiB are needed")
        iox2.set_log_level_from_env_or(iox2.LogLevel.Fatal)
        config = iox2.config.default()
        config.global_cfg.root_path = iox2.Path.new(f"{folder}/{instance}")
        config.global_cfg.prefix = iox2.FileName.new(f"vigil{os.getuid()}_{instance}_")
        self._node = iox2.NodeBuilder.new().config(config).create(iox2.ServiceType.Ipc)
        service = (
            self._node.service_builder(iox2.ServiceName.new("depth"))
            .publish_subscribe(DepthFrame)
            .enable_safe_overflow(True)
            .subscriber_max_buffer_size(1)
            .subscriber_max_borrowed_samples(2)
            .history_size(0)
            .max_publishers(1)
            .max_subscribers(8)
            .open_or_create()
        )
        try:
            self._publisher = service.publisher_builder().create()
        except iox2.PublisherCreateError as error:
            if "ExceedsMaxSupportedPublishers" not in str(error):
                raise
            raise RuntimeError(f"another process already publishes `depth` frames on instance {instance}: stop it") from None
        self._sensor_id = sensor_id
        self._key = None if key_file is None else frame_key(key_file, sensor_id)
        self._sequence = 0
        self._last_stamp_ns = -1
        self._frame = DepthFrame(rows=ROWS, cols=COLS, sensor_id=sensor_id)
        self._pixels = np.frombuffer(self._frame.depth, dtype=np.float32).reshape(ROWS, COLS)

    def publish(self, ranges_m, position_ned_m, attitude_wxyz, stamp_ns: int | None = None) -> int:
        """Publishes one image; returns the number of readers. Raises a ValueError, and publishes nothing, where something is wrong.

        ranges_m: array (128, 256) of real numbers, metres along each pixel's ray, at most 1000; infinity, NaN or 0 where nothing
        returned, which is what 100 m and farther count as. One pixel at least has a range.
        position_ned_m: 3 numbers, the vehicle's estimate at capture, metres as in LOCAL_POSITION_NED.
        attitude_wxyz: unit quaternion, body (FRD) to NED.
        stamp_ns: whole number, time of capture on CLOCK_MONOTONIC, at most a second ago; must rise. Now, if it is not given.
        """
        ranges_m, hit = returns(ranges_m)
        position, attitude = pose(position_ned_m, attitude_wxyz)
        now_ns = time.monotonic_ns()
        try:
            stamp_ns = now_ns if stamp_ns is None else operator.index(stamp_ns)
        except TypeError:
            raise ValueError(f"stamp_ns {stamp_ns!r}: whole nanoseconds of CLOCK_MONOTONIC are needed") from None
        if not max(self._last_stamp_ns + 1, now_ns - OLDEST_NS) <= stamp_ns <= now_ns + STEP_NS:
            raise ValueError(
                f"stamp_ns {stamp_ns} must be newer than that of the frame before ({self._last_stamp_ns}) and of CLOCK_MONOTONIC "
                f"({now_ns} now) within the last second: time.monotonic_ns(), at capture"
            )
        np.divide(ranges_m, FULL_SCALE_M, out=self._pixels, where=hit, casting="same_kind")
        self._pixels[~hit] = 1.0
        frame = self._frame
        frame.stamp_ns = stamp_ns
        frame.sequence = self._sequence
        frame.position_ned_m[:] = position
        frame.attitude_wxyz[:] = attitude
        seal(frame, self._key)
        self._sequence += 1
        self._last_stamp_ns = stamp_ns
        sample = self._publisher.loan_uninit()
        return sample.write_payload(frame).send()
