# SPDX-License-Identifier: MIT
"""Assets, publishers and subscribers: objects over the C interface, arrays over its pointers."""
import ctypes
import dataclasses
import enum
import typing
import warnings

import numpy

from . import _library
from ._library import LIBRARY, Status, check


def _pointer(array, c_type):
    return array.ctypes.data_as(ctypes.POINTER(c_type))


def _text(value):
    return None if value is None else str(value).encode()


class _Object:
    """Owns one object of the C interface; closed once, at the latest when nobody refers to it."""
    _release = staticmethod(lambda handle: None)
    _handle = None

    def close(self):
        handle, self._handle = self._handle, None
        if handle:
            self._release(handle)

    @property
    def closed(self):
        return not self._handle

    def _open(self):
        if not self._handle:
            raise ValueError(f"the {type(self).__name__.lower()} is closed")
        return self._handle

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def __del__(self):
        self.close()

    def _stats(self, function, c_struct, result):
        raw = c_struct()
        check(function(self._open(), ctypes.byref(raw)))
        values = {field: getattr(raw, field.name) for field in dataclasses.fields(result)}
        return result(**{field.name: value.decode("utf-8", "replace") if isinstance(value, bytes) else field.type(value)
                         for field, value in values.items()})


class Asset(_Object):
    """A surface in the form that can be streamed. Immutable; publishers made from it go on living without it. See bake()."""
    _release = staticmethod(LIBRARY.ec_asset_release)

    def __init__(self, handle):
        self._handle = handle
        info = _library.AssetInfo()
        check(LIBRARY.ec_asset_get_info(handle, ctypes.byref(info)))
        self.vertex_count = info.vertex_count
        self.face_count = info.face_count  #: 0: a point cloud.
        self.rank = info.rank
        self.id = info.id.decode()  #: The content id: 64 hexadecimal digits.
        self.from_cache = bool(info.from_cache)  #: Nothing had to be computed.
        self.loose_faces = bool(info.loose_faces)  #: Its faces share no vertices: mesh.weld() first. bake() warns of it.

    def save(self, folder):
        """Writes the asset into a folder, which is made, for load()."""
        check(LIBRARY.ec_asset_save(self._open(), _text(folder)))


def _checked(what, values, shape, dtype):
    """As the library takes them; None where there are none."""
    if values is None:
        return None
    rows = numpy.asarray(values)
    if rows.shape != shape:
        raise ValueError(f"{what} must be {shape}, not {rows.shape}")
    if dtype == numpy.uint8 and rows.dtype.kind == "f":
        raise ValueError(f"{what} must be whole numbers from 0 to 255, not {rows.dtype}: multiply parts of 1 by 255 and round them")
    if dtype == numpy.uint8 and rows.size and (rows.min() < 0 or rows.max() > 255):
        raise ValueError(f"{what} must lie in 0..255")
    return numpy.ascontiguousarray(rows, dtype=dtype)


def bake(positions, faces=None, *, rank=None, basis="augmented", name="", cache_dir=None, progress=None, vertex_colours=None, image=None,
         corner_uv=None, vertex_uv=None, solver="lanczos", quality=None, target_error=None, bitrate=None, poses=None, pose_rate_hz=30,
         columns=None, detail=None):
    """Bakes a surface: seconds for tens of thousands of vertices, nothing when it is in the cache.

      positions  (n, 3)
      faces      (F, 3) vertex numbers, counter-clockwise from outside; None or empty: a point cloud
      rank       coefficients per axis; None: 200, or chosen by a trial where there are poses or one of
      quality      (default: 1) the fewest bits at the error of 200 coefficients coded to within 1e-3 of the diagonal, divided by this
      target_error the fewest bits at this rms vertex error of basis and coding together, over the diagonal
      bitrate      the least error at so many bits a second
      poses      (T, n, 3): an example of the motion, pose_rate_hz of them a second (default: deformations of the surface)
      basis      "augmented", "harmonic", "pca" (of poses), "rig" or "cage" (of columns)
      columns    (n, k): each coordinate of every pose is a combination of them, as of a cage's vertices by its coordinates, or of bones by
                 their weights w and w p
      detail     how what a harmonic or pca basis leaves out of the rest pose comes back: "none", "normal", "frames" (default: "frames" for
                 harmonic)
      solver     "lanczos", or "spectra" for small surfaces
      cache_dir  where results are kept and found again; "" for nowhere (default: the user's cache folder)
      progress   called with a fraction and a stage; what it raises ends the bake and is raised again
      vertex_colours  (n, 3) of 0..255, sRGB
      image      bytes of a whole PNG or JPEG file, at most 16 MiB and 8,192 pixels a side, with one of
      corner_uv    (F, 3, 2): where in the image the corners of each face lie, (0, 0) its upper left corner; a face with a NaN has none of it
      vertex_uv    (n, 2): the same without seams
    Raises Error, ValueError (shapes).
    """
    positions = numpy.ascontiguousarray(positions, dtype=numpy.float64)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ValueError(f"positions must be (n, 3), not {positions.shape}")
    given = numpy.empty((0, 3)) if faces is None else numpy.asarray(faces)
    if given.ndim != 2 or given.shape[1] != 3:
        raise ValueError(f"faces must be (F, 3), not {given.shape}")
    if given.size and (given.min() < 0 or given.max() >= len(positions)):
        raise ValueError(f"faces name vertices outside 0..{len(positions) - 1}")
    triangles = numpy.ascontiguousarray(given, dtype=numpy.uint32)
    n, f = len(positions), len(triangles)
    colours = _checked("vertex_colours", vertex_colours, (n, 3), numpy.uint8)
    corners = _checked("corner_uv", corner_uv, (f, 3, 2), numpy.float32)
    vertices = _checked("vertex_uv", vertex_uv, (n, 2), numpy.float32)
    file = None if image is None else bytes(image)
    appearance = _library.Appearance(image=file, image_size=0 if file is None else len(file))
    for what, rows, c_type in (("vertex_colours", colours, ctypes.c_uint8), ("corner_uv", corners, ctypes.c_float),
                               ("vertex_uv", vertices, ctypes.c_float)):
        if rows is not None:
            setattr(appearance, what, _pointer(rows, c_type))
    raised = []

    def on_progress(_, fraction, stage):
        try:
            progress(fraction, stage.decode())
            return 0
        except BaseException as error:  # must not cross the C interface; goes on below
            raised.append(error)
            return 1

    given = None if poses is None else numpy.ascontiguousarray(poses, dtype=numpy.float32)
    if given is not None and given.shape[1:] != (n, 3):
        raise ValueError(f"poses must be (T, {n}, 3), not {given.shape}")
    spanning = None if columns is None else numpy.ascontiguousarray(columns, dtype=numpy.float64)
    if spanning is not None and (spanning.ndim != 2 or len(spanning) != n):
        raise ValueError(f"columns must be ({n}, k), not {spanning.shape}")
    options = _library.BakeOptions(basis=_text(basis), rank=rank or 0, quality=quality or 0, target_error=target_error or 0, bitrate=bitrate or 0,
                                   pose_rate_hz=pose_rate_hz, pose_count=0 if given is None else len(given), name=_text(name), cache_dir=_text(cache_dir), solver=_text(solver),
                                   detail=_text(detail), column_count=0 if spanning is None else spanning.shape[1])
    if spanning is not None:
        options.columns = _pointer(spanning, ctypes.c_double)
    options.appearance = ctypes.pointer(appearance)
    if given is not None:
        options.poses = _pointer(given, ctypes.c_float)
    if progress is not None:
        options.progress = _library.PROGRESS(on_progress)
    handle = ctypes.c_void_p()
    status = LIBRARY.ec_bake(_pointer(positions, ctypes.c_double), len(positions), _pointer(triangles, ctypes.c_uint32), len(triangles),
                             ctypes.byref(options), ctypes.byref(handle))
    if raised:
        raise raised[0]
    check(status)
    asset = Asset(handle)
    if asset.loose_faces:
        warnings.warn(f"the {f} faces share no vertices, so that they bend apart and cost as much as so many surfaces; join their corners first: "
                      "vertices, faces = eigencast.mesh.weld(positions, faces), then use positions[vertices]", stacklevel=2)
    return asset


def load(folder, asset_id):
    """The asset of that content id, from a folder that Asset.save() or `eigencast-sender bake --out` wrote: nothing is computed. Raises Error."""
    handle = ctypes.c_void_p()
    check(LIBRARY.ec_asset_load(_text(folder), _text(asset_id), ctypes.byref(handle)))
    return Asset(handle)


def _access(token, ca_file, certificate_file, key_file, insecure):
    return {"token": _text(token), "ca_file": _text(ca_file), "certificate_file": _text(certificate_file), "key_file": _text(key_file),
            "insecure": int(insecure)}


class Sent(enum.Enum):
    """What became of a pose."""
    SENT = Status.OK
    DROPPED = Status.DROPPED  #: The next pose supersedes it; stats() count why.
    DISCONNECTED = Status.DISCONNECTED  #: There is no connection now; it is being made anew in the background.


@dataclasses.dataclass(frozen=True)
class PublisherStats:
    live: bool
    subscribers: int
    frames_sent: int
    frames_dropped: int
    bytes_sent: int
    reconnects: int
    dropped_disconnected: int  #: of frames_dropped: there was no connection
    dropped_behind: int  #: too much waited for the link
    dropped_time: int  #: capture_us was not after that of the pose before
    dropped_unusable: int  #: they could not be coded
    detail: str  #: for people: what is going on, why the last pose could not be coded


@dataclasses.dataclass(frozen=True)
class Scalar:
    """A value that rides on each vertex."""
    name: str  #: 1 to 64 of letters, digits, '.', '_' and '-'; differs from the others
    unit: str = ""
    low: float = 0.0  #: to `high`: the range to expect, for colours
    high: float = 0.0
    error: float = 0.0  #: root mean square error that quantising may add, in its unit; 0: a thousandth of the range, or that of positions


class Publisher(_Object):
    """Publishes one deforming surface to http://host:port/stream, and keeps doing so across lost connections; with
    http://a:7490,b:7490/stream at the next broker of the cluster.

      error               root mean square vertex error that quantising may add, model units (default: that of the asset's trial, else 1e-3 of the diagonal)
      bitrate             bits a second to keep to (default: as the error takes)
      still_heartbeat_us  while the surface stands still, send it only so often (default: every pose)
      scalars             what rides on each vertex: a list of Scalar, or of their names
      velocities          poses come with velocities, for viewers that ask for scheme=hermite
      memory              poses that all hold, so that motion that comes again takes a fraction of the bits: "auto", as far as
                          that pays; "on", all that is new at once; "off" (default)
      learn               columns of what the basis misses, learnt from the first seconds, for less error at as many bits: "auto",
                          where that pays; "on", wherever there are some; "off" (default)
      token               shown to the broker; "@FILE" reads it (default: EIGENCAST_TOKEN of the environment)
    """
    _release = staticmethod(LIBRARY.ec_publisher_release)

    def __init__(self, url, asset, *, codec="quantised", error=0.0, key_rate_hz=30.0, bitrate=0.0, still_heartbeat_us=0, scalars=(),
                 velocities=False, memory="auto", learn="off", token=None, ca_file=None, certificate_file=None, key_file=None, insecure=False):
        scalars = [Scalar(each) if isinstance(each, str) else each for each in scalars]
        c_scalars = (_library.Scalar * len(scalars))(*((_text(s.name), _text(s.unit), s.low, s.high, s.error) for s in scalars))
        options = _library.PublisherOptions(codec=_text(codec), error=error, key_rate_hz=key_rate_hz, bitrate=bitrate,
                                            still_heartbeat_us=still_heartbeat_us, scalars=len(scalars), scalar_info=c_scalars, velocities=int(velocities),
                                            memory=_text(memory), learn=_text(learn),
                                            **_access(token, ca_file, certificate_file, key_file, insecure))
        handle = ctypes.c_void_p()
        check(LIBRARY.ec_publisher_create(_text(url), asset._open(), ctypes.byref(options), ctypes.byref(handle)))
        self._handle = handle
        n = asset.vertex_count
        self._shapes = {"positions": (n, 3), "velocities": (n, 3) if velocities else None, "scalars": (n, len(scalars)) if scalars else None}

    def _rows(self, what, values):
        """As the library takes them; None where the publisher was not made for them."""
        shape = self._shapes[what]
        if (values is None) != (shape is None):
            raise ValueError(f"{what} {'must be given' if values is None else 'were not announced'}: see Publisher({what}=...)")
        if values is None:
            return None
        rows = numpy.ascontiguousarray(values, dtype=numpy.float32)
        if what == "scalars" and rows.ndim == 1:
            rows = rows[:, None]
        if rows.shape != shape:
            raise ValueError(f"{what} must be {shape}, not {rows.shape}")
        return rows

    def send(self, positions, capture_us=None, *, velocities=None, scalars=None):
        """Sends a pose, (n, 3) in the order that was baked, as of `capture_us` (default: now; must grow), with velocities (n, 3) per second
        and scalars (n, s) where they were announced. Never blocks."""
        given = {what: self._rows(what, values)
                 for what, values in (("positions", positions), ("velocities", velocities), ("scalars", scalars))}
        pose = _library.PoseToSend(capture_us=_library.now_us() if capture_us is None else int(capture_us))
        for what, rows in given.items():
            if rows is not None:
                setattr(pose, what, _pointer(rows, ctypes.c_float))
        return Sent(check(LIBRARY.ec_publisher_send_pose(self._open(), ctypes.byref(pose))))

    def wait_live(self, timeout=10.0):
        """Waits at most `timeout` seconds until poses go out: what is sent before is DISCONNECTED. False: not yet. Raises Error (refused for good)."""
        return check(LIBRARY.ec_publisher_wait_live(self._open(), max(0, round(1000 * timeout)))) == Status.OK

    def stats(self):
        return self._stats(LIBRARY.ec_publisher_get_stats, _library.PublisherStats, PublisherStats)


@dataclasses.dataclass(frozen=True)
class Pose:
    """A rebuilt surface of N vertices, coarse to fine."""
    positions: numpy.ndarray  #: (N, 3) float32
    normals: typing.Optional[numpy.ndarray]  #: (N, 3) float32, unit length; None for point clouds
    triangles: numpy.ndarray  #: (T, 3) uint32, all below N
    source_vertex: numpy.ndarray  #: (N,) uint32: which vertex of the publisher's surface each one is
    capture_us: int  #: when it holds, on the publisher's clock
    sequence: int  #: number of the key pose that this is or leads up to
    interpolated: bool  #: made between two key poses
    scalars: numpy.ndarray  #: (N, s) float32: what rides on the vertices; s may be 0
    scalar_info: tuple  #: s of Scalar; () where the sender does not say
    velocities: typing.Optional[numpy.ndarray]  #: (N, 3) float32 per second; None where the stream carries none
    vertex_colours: typing.Optional[numpy.ndarray]  #: (N, 3) uint8, sRGB; None where the surface has none
    corner_uv: typing.Optional[numpy.ndarray]  #: (T, 3, 2) float32, NaN where a triangle has none of the image; None without a texture

    @property
    def points(self):
        return self.positions

    @property
    def faces(self):
        return self.triangles

    def in_source_order(self):
        """(N, 3) positions in the publisher's order of vertices; of a whole surface (detail 1) alone."""
        ordered = numpy.empty_like(self.positions)
        ordered[self.source_vertex] = self.positions
        return ordered


@dataclasses.dataclass(frozen=True)
class SubscriberStats:
    live: bool
    keys: int
    interpolated: int
    bytes_received: int
    missed: int
    reconnects: int
    latency_p50_us: int
    latency_p99_us: int
    retry_in_us: int


@dataclasses.dataclass(frozen=True)
class Past:
    """What a broker keeps of a stream; times are microseconds since 1970 on its clock."""
    now_us: int  # 0: it has not said yet
    spans: tuple  # of (from_us, to_us), ascending
    at_us: typing.Optional[int]  # of the current pose; None: it is live


class Subscriber(_Object):
    """Watches http://host:port/stream[?rate=raw], and keeps doing so across lost connections; several brokers as of Publisher.

      detail     fraction of the vertices to rebuild, 0..1
      max_vertices  instead: at most so many, but no fewer than the coarsest level of detail has
      cache_dir  where downloaded assets are kept; "" for nowhere (default: the user's cache folder)
      max_memory_bytes  what the surface may take (default: with all others of the process, three quarters of the machine's)
    """
    _release = staticmethod(LIBRARY.ec_subscriber_release)

    def __init__(self, url, *, detail=1.0, max_vertices=None, cache_dir=None, token=None, ca_file=None, certificate_file=None, key_file=None, insecure=False,
                 max_memory_bytes=0):
        options = _library.SubscriberOptions(cache_dir=_text(cache_dir), max_memory_bytes=max_memory_bytes,
                                             **_access(token, ca_file, certificate_file, key_file, insecure))
        handle = ctypes.c_void_p()
        check(LIBRARY.ec_subscriber_create(_text(url), ctypes.byref(options), ctypes.byref(handle)))
        self._handle = handle
        self.detail, self.max_vertices = detail, max_vertices

    def next(self, timeout=1.0, *, copy=True):
        """The next pose, oldest first, waiting at most `timeout` seconds; None if none came, also while connecting. Without `copy` its arrays
        are views that hold until the next call, and while the subscriber is open."""
        if check(LIBRARY.ec_subscriber_next(self._open(), max(0, round(1000 * timeout)))) != Status.OK:
            return None
        return self._pose(copy)

    def __iter__(self):
        """All poses from now on, without end."""
        while self._handle:
            pose = self.next()
            if pose is not None:
                yield pose

    def _pose(self, copy=True):
        raw = _library.Surface()
        if self.max_vertices is None:
            check(LIBRARY.ec_subscriber_surface(self._open(), self.detail, ctypes.byref(raw)))
        else:
            check(LIBRARY.ec_subscriber_surface_within(self._open(), self.max_vertices, ctypes.byref(raw)))

        def copied(pointer, *shape):
            if not pointer or not shape[0]:
                return numpy.empty(shape, dtype=pointer._type_)
            view = numpy.ctypeslib.as_array(pointer, shape)
            return view.copy() if copy else view

        n, t = raw.vertex_count, raw.triangle_count
        return Pose(copied(raw.positions, n, 3), copied(raw.normals, n, 3) if raw.normals else None, copied(raw.triangles, t, 3),
                    copied(raw.source_vertex, n), raw.capture_us, raw.sequence, bool(raw.interpolated),
                    copied(raw.scalars, n, raw.scalar_count) if raw.scalar_count else numpy.empty((n, 0), dtype=numpy.float32),
                    tuple(Scalar(s.name.decode(), s.unit.decode(), s.low, s.high) for s in raw.scalar_info[:raw.scalar_count])
                    if raw.scalar_info else (),
                    copied(raw.velocities, n, 3) if raw.velocities else None,
                    copied(raw.vertex_colours, n, 3) if raw.vertex_colours else None,
                    copied(raw.corner_uv, t, 3, 2) if raw.corner_uv else None)

    def seek(self, *, at_us=None, ago=None, speed=1.0):
        """Shows what was at `at_us` (as in past()), or `ago` seconds before now, then what followed at `speed` (0.1 to 10; 0: that pose alone):
        next() passes over all poses of before. Live again by itself at the end of what is kept, and after a lost connection. Where the broker
        does not do it, next() raises Error once."""
        if (at_us is None) == (ago is None):
            raise ValueError("seek: give at_us or ago")
        check(LIBRARY.ec_subscriber_seek(self._open(), at_us if ago is None else -max(1, round(1e6 * ago)), speed))

    def step(self, forward=True):
        """Shows the pose after the current one, or the one before it, alone. Raises Error where that is not of the past."""
        check(LIBRARY.ec_subscriber_step(self._open(), int(forward)))

    def live(self):
        """Back to what is live."""
        check(LIBRARY.ec_subscriber_live(self._open()))

    def past(self):
        """What is kept, and where in it the current pose is, as the broker has said it to next()."""
        raw = _library.Past()
        check(LIBRARY.ec_subscriber_get_past(self._open(), ctypes.byref(raw)))
        return Past(raw.now_us, tuple((span.from_us, span.to_us) for span in raw.spans[:raw.span_count]), raw.at_us if raw.is_past else None)

    def image(self):
        """The PNG or JPEG file that corner_uv of the current pose point into, as bytes; None without a texture. It stays with the surface:
        once is enough."""
        raw = _library.Surface()
        check(LIBRARY.ec_subscriber_surface(self._open(), 0.0, ctypes.byref(raw)))
        return ctypes.string_at(raw.image, raw.image_size) if raw.image else None

    def stats(self):
        return self._stats(LIBRARY.ec_subscriber_get_stats, _library.SubscriberStats, SubscriberStats)


def watch(url, **options):
    """The poses of a stream from now on, without end; options as of Subscriber. Their arrays are views, not copies: they hold until the next
    pose is asked for, and while the pose is kept; copy what is to stay. Raises Error."""
    subscriber = Subscriber(url, **options)  # Ends with the last of its poses.
    while True:
        pose = subscriber.next(copy=False)
        if pose is not None:
            object.__setattr__(pose, "_subscriber", subscriber)
            yield pose
