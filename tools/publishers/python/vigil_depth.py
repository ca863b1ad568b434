"""Publishes depth frames to Vigil from Python: docs/sensor-interface.md is the interface.

    publisher = DepthPublisher(instance=0, sensor_id=1)
    publisher.publish(ranges_m, position_ned_m, attitude_wxyz)

Needs the packages `iceoryx2` 0.10 and `xxhash`; `numpy` for images; `blake3` where frames are authenticated.
"""

import ctypes
import os
import pathlib
import struct
import time

import iceoryx2 as iox2
import numpy as np
import xxhash

ROWS, COLS = 128, 256
PIXELS = ROWS * COLS
FULL_SCALE_M = 100.0
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

    content = pathlib.Path(path).read_bytes()
    secret = content if len(content) == 32 else bytes.fromhex(content.decode().strip())
    if len(secret) != 32 or not any(secret):
        raise ValueError(f"{path} is not a key: it needs 32 bytes or 64 hexadecimal digits, not all zero")
    boot = pathlib.Path("/proc/sys/kernel/random/boot_id").read_bytes().strip()
    material = secret + struct.pack("<I", sensor_id) + boot
    return blake3.blake3(material, derive_key_context=KEY_CONTEXT).digest()


class DepthPublisher:
    """The one source of frames of an instance of Vigil. A second one is refused by iceoryx2."""

    def __init__(self, instance: int = 0, sensor_id: int = 1, key_file: os.PathLike | str | None = None):
        folder = pathlib.Path(f"/dev/shm/vigil-{os.getuid()}")
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.stat().st_mode & 0o077:
            raise PermissionError(f"{folder} must be closed to others: chmod 700 {folder}")
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
        self._publisher = service.publisher_builder().create()
        self._sensor_id = sensor_id
        self._key = None if key_file is None else frame_key(key_file, sensor_id)
        self._sequence = 0
        self._frame = DepthFrame(rows=ROWS, cols=COLS, sensor_id=sensor_id)
        self._pixels = np.frombuffer(self._frame.depth, dtype=np.float32).reshape(ROWS, COLS)

    def publish(self, ranges_m, position_ned_m, attitude_wxyz, stamp_ns: int | None = None) -> int:
        """Publishes one image; returns the number of readers.

        ranges_m: array (128, 256), metres along each pixel's ray; infinity, NaN or 0 where nothing returned.
        position_ned_m: 3 numbers, the vehicle's estimate at capture, metres from home.
        attitude_wxyz: unit quaternion, body (FRD) to NED.
        stamp_ns: time of capture on CLOCK_MONOTONIC; now, if it is not given.
        """
        ranges_m = np.asarray(ranges_m, dtype=np.float32)
        if ranges_m.shape != (ROWS, COLS):
            raise ValueError(f"an image of {ROWS} x {COLS} ranges is needed, got {ranges_m.shape}")
        hit = np.isfinite(ranges_m) & (ranges_m > 0.0) & (ranges_m < FULL_SCALE_M)
        np.divide(ranges_m, FULL_SCALE_M, out=self._pixels, where=hit)
        self._pixels[~hit] = 1.0
        frame = self._frame
        frame.stamp_ns = time.monotonic_ns() if stamp_ns is None else stamp_ns
        frame.sequence = self._sequence
        frame.position_ned_m[:] = position_ned_m
        frame.attitude_wxyz[:] = attitude_wxyz
        seal(frame, self._key)
        self._sequence += 1
        sample = self._publisher.loan_uninit()
        return sample.write_payload(frame).send()
