# SPDX-License-Identifier: MIT
"""Stream: a surface as a program has it, baked in a thread and published."""
import atexit
import ctypes
import dataclasses
import enum
import weakref

import numpy

from . import _library
from ._library import LIBRARY, Status, check
from ._objects import Scalar, _access, _Object, _pointer, _text
from .mesh import _numbers

_open_streams = weakref.WeakSet()


@atexit.register
def _close_all():
    """What waits is sent before the interpreter ends."""
    for stream in list(_open_streams):
        stream.close()


class Taken(enum.Enum):
    """What becomes of a pose."""
    SENT = Status.OK
    BAKING = Status.BAKING  #: The surface is being baked; of the poses until then the newest goes out.
    DISCONNECTED = Status.DISCONNECTED  #: Likewise, until there is a connection.


@dataclasses.dataclass(frozen=True)
class StreamStats:
    live: bool
    baking: bool
    loose_faces: bool  #: the faces share no vertices: mesh.weld() first
    subscribers: int
    poses_taken: int
    poses_sent: int  #: taken ones that are not here or below wait for a moment
    poses_early: int  #: a newer one came before max_rate_hz let them out
    poses_superseded: int  #: a newer one came before there was a basis and a connection
    poses_dropped: int  #: the link is behind or gone, or:
    poses_unusable: int  #: of those: they cannot be coded; detail says why
    bytes_sent: int
    bakes: int
    reconnects: int
    detail: str  #: for people: what goes on, or why not


def _scalar(name, given):
    """(low, high[, unit]), a Scalar, or None where nothing is known."""
    if given is None or isinstance(given, Scalar):
        return given or Scalar(name)
    try:
        low, high, unit = (*given, "")[:3]
    except (TypeError, ValueError):
        raise ValueError(f"scalar {name} must be (low, high, unit), a Scalar or None, not {given!r}") from None
    return Scalar(name, unit, low, high)


class Stream(_Object):
    """Streams a surface to http://host:port/stream, or with http://a:7490,b:7490/stream by the next broker in turn: bakes in a thread at
    the first pose, and again when the faces are others, publishes, and keeps doing so across lost connections. Use from one thread.

      rank         coefficients per axis; basis, name, target_error, cache_dir: as of bake()
      up, scale    "y" or "z": the axis that is up in what is sent, and its units in the stream's
      scalars      what rides on each point: {name: (low, high, unit)}; None: the range is learnt, and a pose far outside of it begins the
                   stream anew, without a bake
      max_rate_hz  of poses that come faster the newest waits for its turn; math.inf: no limit
      on_topology  other faces than the first are another surface ("rebake") or an error ("raise")
      error, bitrate, memory, learn, token and the files of TLS: as of Publisher
    In a forked process send() raises, and close() leaves all to the parent.
    """
    _release = staticmethod(LIBRARY.ec_stream_release)

    def __init__(self, url, rank=200, *, up="y", scale=1.0, scalars=None, max_rate_hz=30.0, on_topology="rebake", basis="augmented", name="",
                 target_error=None, cache_dir=None, error=0.0, bitrate=0.0, memory="auto", learn="off", token=None, ca_file=None, certificate_file=None,
                 key_file=None, insecure=False):
        if on_topology not in ("rebake", "raise"):
            raise ValueError("on_topology must be rebake or raise")
        if not max_rate_hz > 0:
            raise ValueError("max_rate_hz must be above 0; math.inf is no limit")
        if not scale > 0 or (rank or 0) < 0:
            raise ValueError("scale must be above 0, and rank at least 0")
        known = [_scalar(name, given) for name, given in dict(scalars or {}).items()]
        c_scalars = (_library.Scalar * len(known))(*((_text(s.name), _text(s.unit), s.low, s.high, s.error) for s in known))
        bake = _library.BakeOptions(rank=0 if target_error else rank or 0, basis=_text(basis), name=_text(name), target_error=target_error or 0,
                                    cache_dir=_text(cache_dir))
        publisher = _library.PublisherOptions(error=error, bitrate=bitrate, memory=_text(memory), learn=_text(learn), scalars=len(known), scalar_info=c_scalars,
                                              **_access(token, ca_file, certificate_file, key_file, insecure))
        options = _library.StreamOptions(bake=ctypes.pointer(bake), publisher=ctypes.pointer(publisher), up=_text(up), scale=scale,
                                         max_rate_hz=max_rate_hz, refuse_topology=int(on_topology == "raise"))
        handle = ctypes.c_void_p()
        check(LIBRARY.ec_stream_create(_text(url), ctypes.byref(options), ctypes.byref(handle)))
        self._handle = handle
        self._scalars = [s.name for s in known]
        self._topology = None
        _open_streams.add(self)

    def send(self, points, faces=None, offsets=None, *, scalars=None, velocities=None, time_s=None, topology=None):
        """Takes a pose, and says what becomes of it (Taken). Never waits: it compares and copies, all else is done by a thread.

          points      (n, 3)
          faces       (F, 3) numbers of points, (P, k) polygons, or the corners of all with `offsets`, (P + 1,), where each begins; polygons
                      are fanned once. None: as in the pose before, or a point cloud. Compared by content
          scalars     {name: (n,)} of those announced, or (n, s)
          velocities  (n, 3) per second, with all poses of a surface or with none
          time_s      when it holds, on a clock of the program's, as far as that keeps pace (default: now)
          topology    names the faces: while it stays they are not looked at
        Raises Error (also what the bake of this surface did), ValueError (shapes).
        """
        rows = numpy.ascontiguousarray(points, dtype=numpy.float32)
        if rows.ndim != 2 or rows.shape[1] != 3:
            raise ValueError(f"points must be (n, 3), not {rows.shape}")
        n = len(rows)
        frame = _library.Frame(point_count=n, points=_pointer(rows, ctypes.c_float))
        if faces is None and offsets is not None:
            raise ValueError("offsets say where the polygons of faces begin: give faces as well")
        if faces is not None and (topology is None or topology != self._topology):
            corners, starts = self._polygons(faces, offsets)
            frame.corners, frame.corner_count = _pointer(corners, ctypes.c_uint32), corners.size
            if starts is not None:
                frame.offsets, frame.offset_count = _pointer(starts, ctypes.c_uint64), starts.size
        values = self._values(scalars, n)
        if values is not None:
            frame.scalars = _pointer(values, ctypes.c_float)
        if velocities is not None:
            speeds = numpy.ascontiguousarray(velocities, dtype=numpy.float32)
            if speeds.shape != rows.shape:
                raise ValueError(f"velocities must be {rows.shape}, not {speeds.shape}")
            frame.velocities = _pointer(speeds, ctypes.c_float)
        if time_s is not None:
            frame.time_s = ctypes.pointer(ctypes.c_double(time_s))
        taken = Taken(check(LIBRARY.ec_stream_send(self._open(), ctypes.byref(frame))))
        self._topology = topology
        return taken

    @staticmethod
    def _polygons(faces, offsets):
        corners = _numbers(faces, numpy.uint32, "faces")
        if offsets is not None:
            return corners.reshape(-1), _numbers(offsets, numpy.uint64, "offsets").reshape(-1)
        if corners.size and corners.ndim != 2:
            raise ValueError(f"faces must be (F, 3) or (P, k), not {corners.shape}, or have offsets")
        if corners.size == 0 or corners.shape[1] == 3:
            return corners, None
        if corners.shape[1] < 3:
            raise ValueError(f"a face has three corners or more, not {corners.shape[1]}")
        return corners, numpy.arange(0, corners.size + 1, corners.shape[1], dtype=numpy.uint64)

    def _values(self, scalars, n):
        """(n, s) of those announced; None where there are none."""
        if not self._scalars or scalars is None:
            if self._scalars or scalars is not None:
                raise ValueError(f"scalars {self._scalars} were announced: give those")
            return None
        if isinstance(scalars, dict):
            if set(scalars) != set(self._scalars):
                raise ValueError(f"scalars {self._scalars} were announced, not {sorted(scalars)}")
            columns = [numpy.asarray(scalars[name]) for name in self._scalars]
            for name, column in zip(self._scalars, columns):
                if column.size != n:
                    raise ValueError(f"scalar {name} must be {(n,)}, not {column.shape}")
            scalars = numpy.stack([column.reshape(n) for column in columns], axis=-1)
        values = numpy.ascontiguousarray(scalars, dtype=numpy.float32)
        if values.size != n * len(self._scalars):
            raise ValueError(f"scalars must be {(n, len(self._scalars))}, not {values.shape}")
        return values.reshape(n, len(self._scalars))

    def wait_live(self, timeout=60.0):
        """Waits at most `timeout` seconds until poses go out; False: not yet. Raises Error (refused, the bake failed, nothing was sent)."""
        return check(LIBRARY.ec_stream_wait_live(self._open(), round(1000 * min(max(timeout, 0), 2e6)))) == Status.OK

    @property
    def stats(self):
        return self._stats(LIBRARY.ec_stream_get_stats, _library.StreamStats, StreamStats)

    def close(self):
        """Sends what waits, within a second, gives up a bake, and disconnects."""
        _open_streams.discard(self)
        super().close()
