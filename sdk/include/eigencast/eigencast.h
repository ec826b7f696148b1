/* SPDX-License-Identifier: MIT */
/**
 * libeigencast, the C interface: bake a surface, publish its motion, subscribe to one.
 *
 * Conventions
 *  - Functions that can fail return an ec_status: EC_OK is 0, errors are negative, other outcomes positive.
 *    ec_last_error() has the words for the last error on the calling thread.
 *  - Option and result structs begin with `struct_size`, which the caller sets to sizeof the struct (EC_INIT does it),
 *    so that fields can be appended without breaking programs built before. A zero or null field means its default.
 *  - Strings are UTF-8 and end with a zero. The library copies what it is given and keeps no pointer past a call.
 *  - Times are microseconds; ec_now_us() reads the clock that publishers and subscribers use.
 *  - An object is used from one thread at a time; different objects are independent. No C++ exception crosses this
 *    interface.
 */
#ifndef EIGENCAST_EIGENCAST_H
#define EIGENCAST_EIGENCAST_H

#include <stddef.h>
#include <stdint.h>

#if defined(__GNUC__)
#define EC_API __attribute__((visibility("default")))
#else
#define EC_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/** The outcome of a call. */
typedef enum ec_status {
  EC_OK = 0,
  EC_DROPPED = 1, /**< This frame was not sent, for a reason that the statistics count; the next one supersedes it. */
  EC_DISCONNECTED = 2, /**< There is no connection now; it is being made anew in the background. */
  EC_NOTHING = 3,      /**< Nothing came within the time given. */
  EC_BAKING = 4,       /**< The surface is being baked; of the poses that come meanwhile the newest goes out then. */

  EC_INVALID_ARGUMENT = -1, /**< An argument that cannot be meant. */
  EC_NOT_FOUND = -2,        /**< A file, stream or asset that is not there. */
  EC_CORRUPT = -3,          /**< Bytes that break their format. */
  EC_TOO_LARGE = -4,        /**< Over a limit. */
  EC_UNSUPPORTED = -5,      /**< Well-formed, but of a kind that this build does not handle. */
  EC_IO = -6,               /**< The operating system refused. */
  EC_UNREACHABLE = -7,      /**< No connection could be made. */
  EC_REFUSED = -8,          /**< The peer said no. */
  EC_CANCELLED = -9,        /**< The caller asked to stop. */
  EC_NUMERICAL = -10,       /**< A computation did not converge. */
  EC_INTERNAL = -11         /**< A bug of Eigencast. */
} ec_status;

/** Initialiser of an option or result struct: `ec_bake_options options = EC_INIT(ec_bake_options);` */
#ifdef __cplusplus
#define EC_INIT(type)                 \
  ([] {                               \
    type value = type();              \
    value.struct_size = sizeof(type); \
    return value;                     \
  }())
#else
#define EC_INIT(type) \
  { .struct_size = sizeof(type) }
#endif

/** The library's version, such as "0.1.0". */
EC_API const char* ec_version(void);
/** The name of a status, such as "invalid-argument". Never null. */
EC_API const char* ec_strerror(ec_status status);
/** What the last error on this thread was: what, where, why, what to do. Valid until the next call on this thread.
 * Never null. */
EC_API const char* ec_last_error(void);
/** Now, in microseconds, on the clock of capture times. */
EC_API int64_t ec_now_us(void);

/* ---- baking: a surface becomes an asset ---- */

/** A surface in the form that can be streamed: spectral basis, order of its levels of detail, faces. Immutable. */
typedef struct ec_asset ec_asset;

/** Reports how far a bake is (0..1) and what it does. Called on the thread that bakes. Returns 0 to go on, anything
 * else to cancel. */
typedef int (*ec_progress)(void* user, double fraction, const char* stage);

/** The appearance of a surface: colours of its vertices, an image on its faces, or both: viewers show the product. */
typedef struct ec_appearance {
  size_t struct_size;
  const uint8_t* vertex_colours; /**< vertex_count x 3: red, green, blue, sRGB (default: none). */
  const void* image;      /**< A whole PNG or JPEG file of at most 16 MiB, 8,192 pixels a side (default: none). */
  size_t image_size;      /**< Its bytes. */
  const float* corner_uv; /**< face_count x 3 x 2: where in the image the corners of each face lie; (0, 0) is its upper
                             left corner, (1, 1) its lower right one, beyond it repeats. Corners that meet in a vertex
                             may lie apart (seams). A face with a corner that is not a number (NAN) has none of it. */
  const float* vertex_uv; /**< vertex_count x 2, instead of corner_uv: for an image without seams. */
} ec_appearance;

typedef struct ec_bake_options {
  size_t struct_size;
  const char* basis; /**< "augmented", "harmonic", "pca" of `poses`, "rig" or "cage" of `columns` (default:
                        "augmented"). */
  uint32_t rank;     /**< Coefficients per axis (default: by a trial where there are poses or a wish, else 200; less
                        on surfaces too small for that). */
  const char* name;  /**< Of the surface, for people (default: ""). */
  const char*
      cache_dir; /**< Where results are kept and found again; "" for nowhere (default: the user's cache folder). */
  ec_progress progress;            /**< (default: none) */
  void* user;                      /**< Handed to `progress`. */
  const ec_appearance* appearance; /**< Colours and texture (default: none). */
  const char* solver;              /**< "lanczos" or "spectra", which is for small surfaces (default: "lanczos"). */
  /* Without a rank: what the basis, and the error of publishers that state none, are chosen for. At most one. */
  double quality; /**< The fewest bits at the error of 200 coefficients coded to within 1e-3 of the diagonal, divided
                          by this (default: 1 where there are poses). */
  double target_error; /**< The fewest bits at this rms vertex error of basis and coding together, over the diagonal. */
  double bitrate;      /**< The least error at so many bits a second. */
  const float* poses;  /**< pose_count x vertex_count x 3: an example of the motion, to choose by (default: deformations
                          of the surface), or what a pca basis learns. */
  uint32_t pose_count;
  double pose_rate_hz;   /**< Poses a second (default: 30). */
  const double* columns; /**< vertex_count x column_count, row-major: each coordinate of every pose is a combination of
                            them, as of the vertices of a cage by its coordinates, or of bones by w and w p (default:
                            none). */
  uint32_t column_count; /**< At most 2048. */
  const char* detail;    /**< "none", "normal" or "frames": how what a harmonic or pca basis leaves out of the rest pose
                            comes back (default: "frames" for harmonic, else "none"). */
} ec_bake_options;

typedef struct ec_asset_info {
  size_t struct_size;
  uint32_t vertex_count;
  uint32_t face_count; /**< 0: a point cloud. */
  uint32_t rank;
  char id[65];     /**< The content id: 64 hexadecimal digits. */
  int from_cache;  /**< 1 when nothing had to be computed. */
  int loose_faces; /**< 1 when its faces share no vertices: they bend apart, and cost as much as so many surfaces.
                      ec_mesh_weld() first. */
} ec_asset_info;

/**
 * Bakes a surface; takes seconds for tens of thousands of vertices, nothing when it is in the cache.
 *   positions  vertex_count x 3
 *   faces      face_count x 3 vertex numbers, counter-clockwise from outside; null with face_count 0 for a point cloud
 *   options    null for all defaults
 * On EC_OK *asset is the caller's to release.
 * Errors: EC_INVALID_ARGUMENT, EC_TOO_LARGE, EC_NUMERICAL, EC_CANCELLED, EC_IO; EC_UNSUPPORTED (an image that is
 * neither PNG nor JPEG).
 */
EC_API ec_status ec_bake(const double* positions, uint32_t vertex_count, const uint32_t* faces, uint32_t face_count,
                         const ec_bake_options* options, ec_asset** asset);
/**
 * Loads an asset from a folder that ec_asset_save() or `eigencast-sender bake --out` wrote: nothing is computed.
 *   id  its content id, as its bake gave it
 * On EC_OK *asset is the caller's to release.
 * Errors: EC_NOT_FOUND, EC_CORRUPT, EC_IO, EC_TOO_LARGE, EC_UNSUPPORTED (of a newer version), EC_INVALID_ARGUMENT.
 */
EC_API ec_status ec_asset_load(const char* folder, const char* id, ec_asset** asset);
/** Writes the asset's objects into a folder, which is made: for other machines, and for programs that must not bake.
 * Errors: EC_IO. */
EC_API ec_status ec_asset_save(const ec_asset* asset, const char* folder);
EC_API ec_status ec_asset_get_info(const ec_asset* asset, ec_asset_info* info);
/** Null is allowed. Publishers made from the asset go on living. */
EC_API void ec_asset_release(ec_asset* asset);

/* ---- meshes as programs have them ---- */

/** Triangles, and which of the program's points they number: stream those points alone. Immutable. */
typedef struct ec_mesh ec_mesh;
typedef struct ec_mesh_arrays {
  size_t struct_size;
  uint32_t vertex_count;    /**< 0: all points, in their order. */
  const uint32_t* vertices; /**< vertex_count: numbers of points, growing. */
  uint32_t face_count;
  const uint32_t* faces; /**< face_count x 3, numbers of `vertices`. */
} ec_mesh_arrays;

/**
 * Splits polygons into fans from their first corners, always the same. Those of fewer than three corners are left out.
 *   connectivity  the corners of all polygons
 *   offsets       where each begins; the last is corner_count: one more than there are polygons
 * On EC_OK *mesh is the caller's to release. Errors: EC_INVALID_ARGUMENT, EC_TOO_LARGE.
 */
EC_API ec_status ec_mesh_triangles(const uint32_t* connectivity, size_t corner_count, const uint64_t* offsets,
                                   size_t offset_count, ec_mesh** mesh);
/**
 * The surface of a solid: the sides that only one cell has, facing away from its middle.
 *   points  point_count x 3
 *   cells   4, 8, 6 or 5 points for each cell, in VTK's order
 *   kind    "tetra", "hexahedron", "wedge" or "pyramid": of all cells
 * On EC_OK *mesh is the caller's to release. Errors: EC_INVALID_ARGUMENT.
 */
EC_API ec_status ec_mesh_boundary(const double* points, uint32_t point_count, const uint32_t* cells,
                                  size_t corner_count, const char* kind, ec_mesh** mesh);
/**
 * Joins each point to the first one within `tolerance` of it that is joined to none; 0: at the same place. Faces that
 * lose a corner are dropped.
 * On EC_OK *mesh is the caller's to release. Errors: EC_INVALID_ARGUMENT.
 */
EC_API ec_status ec_mesh_weld(const double* points, uint32_t point_count, const uint32_t* faces, uint32_t face_count,
                              double tolerance, ec_mesh** mesh);
/** The arrays belong to the mesh. */
EC_API ec_status ec_mesh_get(const ec_mesh* mesh, ec_mesh_arrays* arrays);
EC_API void ec_mesh_release(ec_mesh* mesh); /**< Null is allowed. */

/* ---- publishing ---- */

/** Publishes one deforming surface to a broker, and keeps doing so across lost connections. */
typedef struct ec_publisher ec_publisher;

/** A value that rides on each vertex (stress, temperature). */
typedef struct ec_scalar {
  const char* name; /**< 1 to 64 of letters, digits, '.', '_' and '-'; differs from the others. */
  const char* unit; /**< At most 16 bytes; null: none. */
  double low, high; /**< The range to expect, for colours; equal: unknown, and learnt by an ec_stream. */
  double error;     /**< Root mean square error that quantising may add, in its unit; 0: a thousandth of the range, or,
                       without one, that of positions. Of a subscriber: 0. */
} ec_scalar;

typedef struct ec_publisher_options {
  size_t struct_size;
  const char* codec;  /**< "quantised", "float32" or "float64" (default: "quantised"). */
  double error;       /**< Root mean square vertex error that quantising may add, in model units (default: that of the
                         asset's trial, else 1e-3 of the surface's diagonal). */
  double key_rate_hz; /**< Poses a second that you intend to send; announced, not enforced (default: 30). */
  double bitrate; /**< Bits a second to keep to, by coarser levels, then fewer bands (default: as the error takes). */
  int64_t still_heartbeat_us; /**< While the surface stands still, send it only so often (default: every pose). */
  const char* token;   /**< Shown to the broker; "@FILE" reads it (default: EIGENCAST_TOKEN of the environment). */
  const char* ca_file; /**< PEM file of the authorities trusted for https:// (default: the system's). */
  const char*
      certificate_file; /**< PEM file of a certificate of your own, for brokers that ask for one (default: none). */
  const char* key_file; /**< PEM file of its private key. */
  int insecure;         /**< Not 0: the broker's certificate is not checked; for trying out only. */
  uint32_t scalars;     /**< Values that ride on each vertex, up to 10 (default: none). */
  int velocities;       /**< Not 0: poses come with velocities, for viewers that ask for scheme=hermite. */
  const ec_scalar* scalar_info; /**< As many as scalars (default: named scalar-1 and so on). */
  const char* memory; /**< Poses that all hold, so that motion that comes again takes a fraction of the bits: "auto", as
                         far as that pays; "on", all that is new at once; "off" (default: "auto"). */
  const char* learn;  /**< Columns of what the basis misses, learnt from the first seconds, for less error at as many
                         bits: "auto", where that pays; "on", wherever there are some; "off" (default: "off"). */
} ec_publisher_options;

typedef struct ec_publisher_stats {
  size_t struct_size;
  int live; /**< 1 when frames go out. */
  uint32_t subscribers;
  uint64_t frames_sent;
  uint64_t frames_dropped;
  uint64_t bytes_sent; /**< Of frames, envelopes included. */
  uint64_t reconnects;
  /* Of frames_dropped: */
  uint64_t dropped_disconnected; /**< There was no connection. */
  uint64_t dropped_behind;       /**< Too much waited for the link. */
  uint64_t dropped_time;         /**< capture_us was not after that of the frame before. */
  uint64_t dropped_unusable;     /**< They could not be coded. */
  const char* detail; /**< For people: "uploading 3.1 of 4.2 MB", why the last frame could not be coded. Valid until the
                         next call on the publisher. */
} ec_publisher_stats;

/**
 * Starts connecting to http://host:port/stream in the background and returns at once. http://a:7490,b:7490/stream names
 * several brokers of a cluster: when one is lost the next is tried at once; the token goes to each.
 * Errors: EC_INVALID_ARGUMENT (URL, stream name, options).
 */
EC_API ec_status ec_publisher_create(const char* url, const ec_asset* asset, const ec_publisher_options* options,
                                     ec_publisher** publisher);
/**
 * Projects a pose on the asset's basis and sends its coefficients. Never blocks.
 *   positions   vertex_count x 3, in the order that was baked
 *   capture_us  when the pose holds, on the clock of ec_now_us(); must grow
 * Returns EC_OK, EC_DROPPED or EC_DISCONNECTED. Errors: EC_INVALID_ARGUMENT (a number is not finite).
 */
EC_API ec_status ec_publisher_send(ec_publisher* publisher, const float* positions, int64_t capture_us);

/** All that a pose says of the vertices, in the order that was baked. */
typedef struct ec_pose {
  size_t struct_size;
  const float* positions;  /**< vertex_count x 3 */
  const float* velocities; /**< vertex_count x 3, per second; null unless the publisher was made for them. */
  const float* scalars;    /**< vertex_count x scalars; null unless the publisher was made for some. */
  int64_t capture_us;      /**< As in ec_publisher_send(). */
} ec_pose;

/** As ec_publisher_send(), with velocities and scalars. Errors: EC_INVALID_ARGUMENT, also for what was not announced or
 * is missing. */
EC_API ec_status ec_publisher_send_pose(ec_publisher* publisher, const ec_pose* pose);
EC_API ec_status ec_publisher_get_stats(const ec_publisher* publisher, ec_publisher_stats* stats);
/**
 * Waits at most `timeout_ms` until poses go out: what is sent before is EC_DISCONNECTED.
 * Returns EC_OK or EC_NOTHING (not yet). Errors: EC_REFUSED (another sender has the stream for good).
 */
EC_API ec_status ec_publisher_wait_live(const ec_publisher* publisher, int timeout_ms);
/** Disconnects, waiting at most a second. Null is allowed. */
EC_API void ec_publisher_release(ec_publisher* publisher);

/* ---- streaming: baking and publishing in one ---- */

/**
 * Streams a surface as a program has it: bakes in a thread at the first pose, and again when the topology is another
 * one by its content, then publishes across lost connections. For a surface with colours, texture or example poses:
 * ec_bake() and ec_publisher_create(). In a process that was forked its functions refuse, and its
 * release leaves all to the parent.
 */
typedef struct ec_stream ec_stream;

typedef struct ec_stream_options {
  size_t struct_size;
  const ec_bake_options* bake;           /**< Without appearance, poses and progress (default: rank 200). */
  const ec_publisher_options* publisher; /**< velocities and key_rate_hz are found out (default: all defaults). */
  const char* up;     /**< "y" or "z": the axis that is up in what is sent; a stream's is y (default: "y"). */
  double scale;       /**< Multiplies points and velocities (default: 1). */
  double max_rate_hz; /**< Of poses that come faster the newest waits for its turn; INFINITY: no limit (default: 30). */
  int refuse_topology; /**< Not 0: another topology than the first is an error (default: another surface). */
} ec_stream_options;

/** A pose of a surface, with its topology. */
typedef struct ec_frame {
  size_t struct_size;
  uint32_t point_count;
  const float* points; /**< point_count x 3 */
  const uint32_t*
      corners; /**< Point numbers of triangles, 3 each, or of polygons; null: all as in the frame before, or a
                              point cloud where there was none. Compared by content. */
  size_t corner_count;
  const uint64_t* offsets; /**< Where polygons begin, then corner_count; they are fanned once (default: triangles).
                            */
  size_t offset_count;
  const float* scalars;    /**< point_count x as many as the publisher's options have. */
  const float* velocities; /**< point_count x 3, per second; with all poses of a surface or with none. */
  const double* time_s;    /**< When it holds, on a clock of the program's, as far as that keeps pace (default: now). */
} ec_frame;

typedef struct ec_stream_stats {
  size_t struct_size;
  int live;        /**< 1 when poses go out. */
  int baking;      /**< 1 while a surface is being baked. */
  int loose_faces; /**< As in ec_asset_info. */
  uint32_t subscribers;
  uint64_t poses_taken;      /**< By ec_stream_send(). */
  uint64_t poses_sent;       /**< To the broker. Taken ones that are not here or below wait for a moment. */
  uint64_t poses_early;      /**< Left out: a newer one came before max_rate_hz let them out. */
  uint64_t poses_superseded; /**< Left out: a newer one came before there was a basis and a connection. */
  uint64_t poses_dropped;    /**< Left out by the publisher: the link is behind or gone, or: */
  uint64_t poses_unusable;   /**< Of those: they cannot be coded; `detail` says why. */
  uint64_t bytes_sent;
  uint64_t bakes; /**< Surfaces so far. */
  uint64_t reconnects;
  const char* detail; /**< For people: what goes on, or why not. Valid until the next call on the stream. */
} ec_stream_stats;

/**
 * Returns at once; baking and connecting begin with the first frame. URLs are those of ec_publisher_create().
 * Errors: EC_INVALID_ARGUMENT (URL, stream name, options).
 */
EC_API ec_status ec_stream_create(const char* url, const ec_stream_options* options, ec_stream** stream);
/**
 * Takes a pose. Never waits: it compares and copies, all else is done by a thread.
 * Returns EC_OK (it goes out), EC_BAKING or EC_DISCONNECTED (if no newer one comes before there is a basis and a
 * connection, it goes out then). Errors: EC_INVALID_ARGUMENT (sizes, numbers that are not finite, a topology that is
 * refused), EC_UNSUPPORTED (in a forked process); those of ec_bake(), until the topology is another one.
 */
EC_API ec_status ec_stream_send(ec_stream* stream, const ec_frame* frame);
/** Waits at most `timeout_ms` until poses go out. Returns EC_OK or EC_NOTHING (not yet). Errors: EC_INVALID_ARGUMENT
 * (nothing was sent), EC_REFUSED (another sender has the stream for good); those of ec_bake(). */
EC_API ec_status ec_stream_wait_live(ec_stream* stream, int timeout_ms);
EC_API ec_status ec_stream_get_stats(const ec_stream* stream, ec_stream_stats* stats);
/** Sends what waits, within a second, gives up a bake, and disconnects. Null is allowed. */
EC_API void ec_stream_release(ec_stream* stream);

/* ---- subscribing ---- */

/** Watches one stream, and keeps doing so across lost connections. */
typedef struct ec_subscriber ec_subscriber;

typedef struct ec_subscriber_options {
  size_t struct_size;
  const char* cache_dir; /**< Where downloaded assets are kept; "" for nowhere (default: the user's cache folder). */
  const char* token;     /**< Shown to the broker; "@FILE" reads it (default: EIGENCAST_TOKEN of the environment). */
  const char* ca_file;   /**< PEM file of the authorities trusted for https:// (default: the system's). */
  const char*
      certificate_file; /**< PEM file of a certificate of your own, for brokers that ask for one (default: none). */
  const char* key_file; /**< PEM file of its private key. */
  int insecure;         /**< Not 0: the broker's certificate is not checked; for trying out only. */
  uint64_t max_memory_bytes; /**< What the surface and its texture may take (default: with all other subscribers of the
                                process, three quarters of the machine's). */
} ec_subscriber_options;

typedef struct ec_subscriber_stats {
  size_t struct_size;
  int live;                /**< 1 when poses come. */
  uint64_t keys;           /**< Poses that the sender sent. */
  uint64_t interpolated;   /**< Poses that were made in between. */
  uint64_t bytes_received; /**< Of frames, envelopes included. */
  uint64_t missed;         /**< Keys that never came. */
  uint64_t reconnects;
  int64_t latency_p50_us; /**< Capture to arrival; meaningful for a sender on this machine. */
  int64_t latency_p99_us;
  int64_t retry_in_us; /**< Until the next try to connect; 0: none is planned. */
} ec_subscriber_stats;

/** A rebuilt surface. The arrays belong to the subscriber and stay until the next call on it. */
typedef struct ec_surface {
  size_t struct_size;
  uint32_t vertex_count; /**< N at this level of detail. */
  uint32_t triangle_count;
  const float* positions;        /**< N x 3 */
  const float* normals;          /**< N x 3, unit length; null for point clouds. */
  const uint32_t* triangles;     /**< triangle_count x 3, all below N. */
  const uint32_t* source_vertex; /**< N: which vertex of the publisher's surface each one is. */
  int64_t capture_us;            /**< When the pose holds, on the publisher's clock. */
  uint64_t sequence;             /**< Number of the key pose that this is or leads up to. */
  int interpolated;              /**< 1 when it was made between two key poses. */
  uint32_t scalar_count;         /**< Values that ride on each vertex. */
  const float* scalars;          /**< N x scalar_count; null where there are none. */
  const float* velocities;       /**< N x 3, per second; null where the stream carries none. */
  const uint8_t* vertex_colours; /**< N x 3, sRGB; null where the surface has none. */
  const float* corner_uv;        /**< triangle_count x 3 x 2 as of ec_appearance, NAN where a triangle has none of the
                                    image; null where the surface has no texture, or until all of it has arrived. */
  const void* image;             /**< The PNG or JPEG file; null with corner_uv. */
  size_t image_size;
  const ec_scalar* scalar_info; /**< scalar_count; null where the sender does not say. */
} ec_surface;

/** Starts connecting to http://host:port/stream[?rate=raw] in the background; several brokers as for publishers.
 * Errors: EC_INVALID_ARGUMENT. */
EC_API ec_status ec_subscriber_create(const char* url, const ec_subscriber_options* options,
                                      ec_subscriber** subscriber);
/**
 * Goes on to the next pose, oldest first, waiting at most `timeout_ms` for one. A caller that is late gets the
 * newest 64. Poses that cannot be rebuilt, because their surface has not begun to arrive or has been replaced, are
 * passed over. Returns EC_OK or EC_NOTHING (also while connecting: ask again).
 */
EC_API ec_status ec_subscriber_next(ec_subscriber* subscriber, int timeout_ms);
/**
 * Rebuilds the current pose.
 *   detail  fraction of the vertices, 0..1
 * Errors: EC_NOT_FOUND before the first pose, and between a change of the stream's surface and its next pose: call
 * ec_subscriber_next() again; EC_INVALID_ARGUMENT.
 */
EC_API ec_status ec_subscriber_surface(ec_subscriber* subscriber, double detail, ec_surface* surface);
/** The same within a budget: at most max_vertices, but no fewer than the coarsest level of detail has. */
EC_API ec_status ec_subscriber_surface_within(ec_subscriber* subscriber, uint32_t max_vertices, ec_surface* surface);
EC_API ec_status ec_subscriber_get_stats(const ec_subscriber* subscriber, ec_subscriber_stats* stats);

/* The past: what the broker keeps of the stream, where the token may see it again (`rewind`). Times are microseconds
 * since 1970 on the broker's clock. */

typedef struct ec_kept_span {
  int64_t from_us, to_us;
} ec_kept_span;

typedef struct ec_past {
  size_t struct_size;
  int64_t now_us;            /**< 0: the broker has not said yet what it keeps. */
  const ec_kept_span* spans; /**< What is kept, ascending; of the time between them there is nothing. Stays until the
                                next call on the subscriber; null where there is none. */
  size_t span_count;
  int is_past;   /**< 1 when the current pose is of the past. */
  int64_t at_us; /**< When that was; else 0. */
} ec_past;

/**
 * Shows the newest pose at a time, then what followed: ec_subscriber_next() passes over all poses of before. Live again
 * by itself at the end of what is kept, and after a lost connection. capture_us of such a surface has no meaning but
 * to pace it: ec_past has its time.
 *   at_us  negative: so long before now; a time of which nothing is kept means the next that is
 *   speed  0.1 to 10; 0: that pose alone
 * Errors: EC_INVALID_ARGUMENT. Where the broker does not do it, ec_subscriber_next() returns EC_REFUSED once, and what
 * was shown goes on.
 */
EC_API ec_status ec_subscriber_seek(ec_subscriber* subscriber, int64_t at_us, double speed);
/** Shows the pose after the current one (forward not 0), or the one before it, alone. Errors: EC_NOT_FOUND: the current
 * pose is not of the past. */
EC_API ec_status ec_subscriber_step(ec_subscriber* subscriber, int forward);
/** Back to what is live. */
EC_API ec_status ec_subscriber_live(ec_subscriber* subscriber);
/** What is kept, and where in it the current pose is. Asks the broker once a second; its answers are heard by
 * ec_subscriber_next(). */
EC_API ec_status ec_subscriber_get_past(ec_subscriber* subscriber, ec_past* past);
/** Disconnects, waiting at most a second. Null is allowed. */
EC_API void ec_subscriber_release(ec_subscriber* subscriber);

#ifdef __cplusplus
}
#endif

#endif
