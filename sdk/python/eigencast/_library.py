# SPDX-License-Identifier: MIT
"""libeigencast's C interface (eigencast/eigencast.h) as ctypes sees it: structs, signatures, statuses."""
import ctypes
import ctypes.util
import enum
import os
from ctypes import POINTER, c_char_p, c_double, c_float, c_int, c_int64, c_size_t, c_uint8, c_uint32, c_uint64, c_void_p

SONAME = "libeigencast.so.0"


class Status(enum.IntEnum):
    """ec_status: errors are negative."""
    OK = 0
    DROPPED = 1
    DISCONNECTED = 2
    NOTHING = 3
    BAKING = 4
    INVALID_ARGUMENT = -1
    NOT_FOUND = -2
    CORRUPT = -3
    TOO_LARGE = -4
    UNSUPPORTED = -5
    IO = -6
    UNREACHABLE = -7
    REFUSED = -8
    CANCELLED = -9
    NUMERICAL = -10
    INTERNAL = -11


class Error(RuntimeError):
    """What went wrong: `status` is stable, the text is for people."""

    def __init__(self, status, text):
        super().__init__(text)
        self.status = Status(status)


PROGRESS = ctypes.CFUNCTYPE(c_int, c_void_p, c_double, c_char_p)


class Sized(ctypes.Structure):
    """A struct of the interface: its first member says how long it is, so that either side may know more members."""

    def __init__(self, **values):
        super().__init__(**values)
        self.struct_size = ctypes.sizeof(self)


class Appearance(Sized):
    _fields_ = [("struct_size", c_size_t), ("vertex_colours", POINTER(c_uint8)), ("image", c_char_p), ("image_size", c_size_t),
                ("corner_uv", POINTER(c_float)), ("vertex_uv", POINTER(c_float))]


class BakeOptions(Sized):
    _fields_ = [("struct_size", c_size_t), ("basis", c_char_p), ("rank", c_uint32), ("name", c_char_p), ("cache_dir", c_char_p),
                ("progress", PROGRESS), ("user", c_void_p), ("appearance", POINTER(Appearance)), ("solver", c_char_p), ("quality", c_double),
                ("target_error", c_double), ("bitrate", c_double), ("poses", POINTER(c_float)), ("pose_count", c_uint32), ("pose_rate_hz", c_double),
                ("columns", POINTER(c_double)), ("column_count", c_uint32), ("detail", c_char_p)]


class AssetInfo(Sized):
    _fields_ = [("struct_size", c_size_t), ("vertex_count", c_uint32), ("face_count", c_uint32), ("rank", c_uint32),
                ("id", ctypes.c_char * 65), ("from_cache", c_int), ("loose_faces", c_int)]


class MeshArrays(Sized):
    _fields_ = [("struct_size", c_size_t), ("vertex_count", c_uint32), ("vertices", POINTER(c_uint32)), ("face_count", c_uint32),
                ("faces", POINTER(c_uint32))]


class Scalar(ctypes.Structure):
    _fields_ = [("name", c_char_p), ("unit", c_char_p), ("low", c_double), ("high", c_double), ("error", c_double)]


class PublisherOptions(Sized):
    _fields_ = [("struct_size", c_size_t), ("codec", c_char_p), ("error", c_double), ("key_rate_hz", c_double), ("bitrate", c_double),
                ("still_heartbeat_us", c_int64), ("token", c_char_p), ("ca_file", c_char_p), ("certificate_file", c_char_p),
                ("key_file", c_char_p), ("insecure", c_int), ("scalars", c_uint32), ("velocities", c_int), ("scalar_info", POINTER(Scalar)),
                ("memory", c_char_p), ("learn", c_char_p)]


class PoseToSend(Sized):
    _fields_ = [("struct_size", c_size_t), ("positions", POINTER(c_float)), ("velocities", POINTER(c_float)), ("scalars", POINTER(c_float)),
                ("capture_us", c_int64)]


class StreamOptions(Sized):
    _fields_ = [("struct_size", c_size_t), ("bake", POINTER(BakeOptions)), ("publisher", POINTER(PublisherOptions)), ("up", c_char_p),
                ("scale", c_double), ("max_rate_hz", c_double), ("refuse_topology", c_int)]


class Frame(Sized):
    _fields_ = [("struct_size", c_size_t), ("point_count", c_uint32), ("points", POINTER(c_float)), ("corners", POINTER(c_uint32)),
                ("corner_count", c_size_t), ("offsets", POINTER(c_uint64)), ("offset_count", c_size_t), ("scalars", POINTER(c_float)),
                ("velocities", POINTER(c_float)), ("time_s", POINTER(c_double))]


class StreamStats(Sized):
    _fields_ = [("struct_size", c_size_t), ("live", c_int), ("baking", c_int), ("loose_faces", c_int), ("subscribers", c_uint32),
                ("poses_taken", c_uint64), ("poses_sent", c_uint64), ("poses_early", c_uint64), ("poses_superseded", c_uint64),
                ("poses_dropped", c_uint64), ("poses_unusable", c_uint64), ("bytes_sent", c_uint64), ("bakes", c_uint64), ("reconnects", c_uint64), ("detail", c_char_p)]


class PublisherStats(Sized):
    _fields_ = [("struct_size", c_size_t), ("live", c_int), ("subscribers", c_uint32), ("frames_sent", c_uint64),
                ("frames_dropped", c_uint64), ("bytes_sent", c_uint64), ("reconnects", c_uint64), ("dropped_disconnected", c_uint64),
                ("dropped_behind", c_uint64), ("dropped_time", c_uint64), ("dropped_unusable", c_uint64), ("detail", c_char_p)]


class KeptSpan(ctypes.Structure):
    _fields_ = [("from_us", c_int64), ("to_us", c_int64)]


class Past(Sized):
    _fields_ = [("struct_size", c_size_t), ("now_us", c_int64), ("spans", POINTER(KeptSpan)), ("span_count", c_size_t),
                ("is_past", c_int), ("at_us", c_int64)]


class SubscriberOptions(Sized):
    _fields_ = [("struct_size", c_size_t), ("cache_dir", c_char_p), ("token", c_char_p), ("ca_file", c_char_p),
                ("certificate_file", c_char_p), ("key_file", c_char_p), ("insecure", c_int), ("max_memory_bytes", c_uint64)]


class SubscriberStats(Sized):
    _fields_ = [("struct_size", c_size_t), ("live", c_int), ("keys", c_uint64), ("interpolated", c_uint64), ("bytes_received", c_uint64),
                ("missed", c_uint64), ("reconnects", c_uint64), ("latency_p50_us", c_int64), ("latency_p99_us", c_int64),
                ("retry_in_us", c_int64)]


class Surface(Sized):
    _fields_ = [("struct_size", c_size_t), ("vertex_count", c_uint32), ("triangle_count", c_uint32), ("positions", POINTER(c_float)),
                ("normals", POINTER(c_float)), ("triangles", POINTER(c_uint32)), ("source_vertex", POINTER(c_uint32)),
                ("capture_us", c_int64), ("sequence", c_uint64), ("interpolated", c_int), ("scalar_count", c_uint32), ("scalars", POINTER(c_float)),
                ("velocities", POINTER(c_float)), ("vertex_colours", POINTER(c_uint8)), ("corner_uv", POINTER(c_float)), ("image", c_void_p),
                ("image_size", c_size_t), ("scalar_info", POINTER(Scalar))]


# name -> (result, arguments)
_SIGNATURES = {
    "ec_version": (c_char_p, []),
    "ec_last_error": (c_char_p, []),
    "ec_now_us": (c_int64, []),
    "ec_bake": (c_int, [POINTER(c_double), c_uint32, POINTER(c_uint32), c_uint32, POINTER(BakeOptions), POINTER(c_void_p)]),
    "ec_asset_load": (c_int, [c_char_p, c_char_p, POINTER(c_void_p)]),
    "ec_asset_save": (c_int, [c_void_p, c_char_p]),
    "ec_asset_get_info": (c_int, [c_void_p, POINTER(AssetInfo)]),
    "ec_asset_release": (None, [c_void_p]),
    "ec_mesh_triangles": (c_int, [POINTER(c_uint32), c_size_t, POINTER(c_uint64), c_size_t, POINTER(c_void_p)]),
    "ec_mesh_boundary": (c_int, [POINTER(c_double), c_uint32, POINTER(c_uint32), c_size_t, c_char_p, POINTER(c_void_p)]),
    "ec_mesh_weld": (c_int, [POINTER(c_double), c_uint32, POINTER(c_uint32), c_uint32, c_double, POINTER(c_void_p)]),
    "ec_mesh_get": (c_int, [c_void_p, POINTER(MeshArrays)]),
    "ec_mesh_release": (None, [c_void_p]),
    "ec_publisher_create": (c_int, [c_char_p, c_void_p, POINTER(PublisherOptions), POINTER(c_void_p)]),
    "ec_publisher_send_pose": (c_int, [c_void_p, POINTER(PoseToSend)]),
    "ec_publisher_get_stats": (c_int, [c_void_p, POINTER(PublisherStats)]),
    "ec_publisher_wait_live": (c_int, [c_void_p, c_int]),
    "ec_publisher_release": (None, [c_void_p]),
    "ec_stream_create": (c_int, [c_char_p, POINTER(StreamOptions), POINTER(c_void_p)]),
    "ec_stream_send": (c_int, [c_void_p, POINTER(Frame)]),
    "ec_stream_wait_live": (c_int, [c_void_p, c_int]),
    "ec_stream_get_stats": (c_int, [c_void_p, POINTER(StreamStats)]),
    "ec_stream_release": (None, [c_void_p]),
    "ec_subscriber_create": (c_int, [c_char_p, POINTER(SubscriberOptions), POINTER(c_void_p)]),
    "ec_subscriber_next": (c_int, [c_void_p, c_int]),
    "ec_subscriber_surface": (c_int, [c_void_p, c_double, POINTER(Surface)]),
    "ec_subscriber_surface_within": (c_int, [c_void_p, c_uint32, POINTER(Surface)]),
    "ec_subscriber_seek": (c_int, [c_void_p, c_int64, c_double]),
    "ec_subscriber_step": (c_int, [c_void_p, c_int]),
    "ec_subscriber_live": (c_int, [c_void_p]),
    "ec_subscriber_get_past": (c_int, [c_void_p, POINTER(Past)]),
    "ec_subscriber_get_stats": (c_int, [c_void_p, POINTER(SubscriberStats)]),
    "ec_subscriber_release": (None, [c_void_p]),
}


def library_path():
    """Where libeigencast is: EIGENCAST_LIBRARY, or in this package (a wheel), or as the system finds it."""
    inside = os.path.join(os.path.dirname(__file__), SONAME)
    return os.environ.get("EIGENCAST_LIBRARY") or (inside if os.path.exists(inside) else SONAME)


def _load():
    try:
        loaded = ctypes.CDLL(library_path())
    except OSError as error:
        raise ImportError(f"{library_path()} cannot be loaded ({error}); install libeigencast0, or name the library in "
                          "EIGENCAST_LIBRARY") from error
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(loaded, name)
        function.restype = result
        function.argtypes = arguments
    return loaded


LIBRARY = _load()


def check(status):
    """Returns the status. Raises Error where it is an error."""
    if status < 0:
        raise Error(status, LIBRARY.ec_last_error().decode("utf-8", "replace"))
    return Status(status)


def version():
    """Of libeigencast, such as "0.1.0"."""
    return LIBRARY.ec_version().decode()


def now_us():
    """Now, in microseconds, on the clock of capture times."""
    return LIBRARY.ec_now_us()
