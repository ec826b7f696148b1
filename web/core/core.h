/* SPDX-License-Identifier: MIT */
#ifndef EIGENCAST_WEB_CORE_H
#define EIGENCAST_WEB_CORE_H

#include <stddef.h>
#include <stdint.h>

/**
 * What eigencast-core.wasm exports: the frame decoder, play-out, asset reader, rebuilding and levels of detail of
 * common/, for web/src/core. One thread.
 *
 * Ownership: what `..._make` and `asset_open` return is the caller's until `..._free`. What else is returned belongs to
 * the object, and holds until the next call with that object. Each call may grow the memory, which moves every view of
 * it: make views anew, from the addresses, after each call. Nothing given is kept after the call, unless it says so.
 *
 * Errors: a negative result is -1 minus the number of an ErrorCode (common/core/result.h), a null pointer an error as
 * well; error_text() says what, where, why. Bytes may be hostile: each length is checked before anything is allocated.
 * Memory that runs out ends in a trap (WebAssembly.RuntimeError), after which the instance is of no use.
 *
 * Times are microseconds: capture times on the sender's clock, others on the caller's. Structures have the layout of
 * C for wasm32, little-endian; `reserved` is zero.
 */
#ifdef __cplusplus
extern "C" {
#endif

#define CORE(name) __attribute__((export_name(#name))) name

enum { CORE_MAX_BANDS = 8, CORE_MAX_CHANNELS = 16 };

/* Memory of the instance that the caller writes what it gives to. At most 256 MiB; null where there is none. */
void* CORE(memory_take)(uint32_t bytes);
void CORE(memory_give)(void* taken);

/* The last error: zero-terminated UTF-8. */
const char* CORE(error_text)(void);

/* SHA-256 of `size` bytes into 32, for hashes of bytes that did not come through here. */
void CORE(hash_sha256)(const uint8_t* bytes, uint32_t size, uint8_t* digest);

/* ---- Frames: a receiver's end of one stream's chain of keys (docs/protocol.md, sections 4 to 8) ---- */

typedef struct core_frames core_frames;

/* `format` and `profile.scheme` of a `stream` message. */
typedef struct {
  double scales[CORE_MAX_CHANNELS]; /* `scale` of each entry of `scalars` */
  uint32_t rows, channels, velocity_channels, velocity_us;
  uint32_t codec;  /* 0 float64, 1 float32, 2 quantised */
  uint32_t scheme; /* 0 linear, 1 catmull-rom, 2 hermite, 3 damped */
  uint32_t scalars, bands, band_ends[CORE_MAX_BANDS];
} core_format;

typedef struct {
  uint64_t sequence;
  int64_t capture_us; /* of the frame */
  int64_t shown_us;   /* of the pose to show: of a key that is ahead, when the step before it holds */
  int64_t next_us;    /* of the key that came ahead */
  uint32_t stream_id, epoch;
  /* rows x channels, row-major, scalars in the sender's units; null: nothing to show. Absent bands: see asset_fill */
  const double* coefficients;
  const double* next; /* likewise of the key that came ahead of the poses that lead up to it: once a key, else null */
  uint32_t count;
  const int32_t* integers; /* count: those of the pose; null with float codecs */
  uint8_t kind, flags;     /* of the frame: 1 key, 2 join, 3 step, 4 estimate; bit 0: ahead */
  uint8_t bands;           /* of the pose; of the frame where there is none */
  uint8_t at, of, step;    /* between keys, or beyond; index of the quantiser's step */
  uint8_t was_read;        /* 1: the fields above are those of this frame, which is to be acknowledged */
  uint8_t next_bands;
} core_pose;

typedef struct {
  uint64_t keys, synthetic, joins, rejected, missed;
} core_counts;

/* The stream id of a frame, or -1: not a frame. */
int64_t CORE(frame_stream_id)(const uint8_t* bytes, uint32_t size);

core_frames* CORE(frames_make)(void);
void CORE(frames_free)(core_frames* frames);
/* What a `stream` message says: another stream, tag, epoch or format starts the chain anew. Null format: nothing
   announced. Errors: invalid-argument (a format out of range). */
int32_t CORE(frames_begin)(core_frames* frames, uint32_t stream_id, uint32_t tag, uint32_t epoch,
                           const core_format* format);
/* Forgets the chain, as after a reconnect: only a join helps. */
void CORE(frames_restart)(core_frames* frames);
/* Keys may be predicted from this segment of a memory of poses, too, behind those given before; of size 0: from none.
   Another stream, epoch or format has none. asset: 32 bytes. Errors, which change nothing: corrupt, unsupported,
   too-large, invalid-argument (a float codec). */
int32_t CORE(frames_remember)(core_frames* frames, const uint8_t* asset, const uint8_t* segment, uint32_t size);
/* 1: frames_pose has coefficients; 0: nothing to show (a key ahead that shows none, another tag, no state yet).
   Errors: corrupt, too-large; the chain then waits for a join. */
int32_t CORE(frames_decode)(core_frames* frames, const uint8_t* bytes, uint32_t size);
const core_pose* CORE(frames_pose)(const core_frames* frames);
const core_counts* CORE(frames_counts)(core_frames* frames);

/* ---- Play-out: when which pose is shown (common/motion/playout.h) ---- */

typedef struct core_playout core_playout;

typedef struct {
  int64_t time_us; /* capture time of what is shown */
  const double* coefficients;
  uint32_t count;
  uint8_t bands;
  uint8_t shown;    /* 0 live, 1 interpolated, 2 estimated, 3 held */
  uint8_t settling; /* 1: an error shown before is fading, so that the pose changes while time_us does not */
  uint8_t reserved;
} core_shown;

core_playout* CORE(playout_make)(void);
void CORE(playout_free)(core_playout* playout);
/* mode  0 latest, 1 interpolate, 2 estimate
   smoothness  0 live to 1 smooth; not a number: the mode's own
   delay_us, max_ahead_us  at least 0; see PlayoutSettings */
int32_t CORE(playout_set)(core_playout* playout, uint32_t mode, double smoothness, int64_t delay_us,
                          int64_t max_ahead_us);
/* The rows at which bands end, at most CORE_MAX_BANDS. */
int32_t CORE(playout_bands)(core_playout* playout, const uint32_t* band_ends, uint32_t bands);
/* 1: taken; 0: not after the newest. is_estimate: of an `estimate` frame. Copies the coefficients, at most 32,768. */
int32_t CORE(playout_add)(core_playout* playout, int64_t time_us, int64_t arrival_us, const double* coefficients,
                          uint32_t count, uint32_t bands, uint32_t is_estimate);
/* Takes a key that came before the poses that lead up to it; dropped where it is not after the newest. */
int32_t CORE(playout_add_next)(core_playout* playout, int64_t time_us, const double* coefficients, uint32_t count,
                               uint32_t bands);
/* What to show now; null before the first pose. */
const core_shown* CORE(playout_at)(core_playout* playout, int64_t now_us);
/* From now on the pose of now_us - lag_us is shown at now_us; INT64_MIN: by the settings. Returns the least lag with
   which all poses of late would have been there in time; INT64_MIN: it is not known yet. */
int64_t CORE(playout_keep_lag)(core_playout* playout, int64_t lag_us);
int64_t CORE(playout_delay_us)(const core_playout* playout);
void CORE(playout_reset)(core_playout* playout);

/* ---- Assets: put together as their chunks arrive (docs/asset-format.md) ---- */

typedef struct core_asset core_asset;

typedef struct {
  uint8_t id[32];
  uint32_t bytes, needed_bytes; /* whole; and leading ones that the asset's bands need */
  uint32_t first_row, end_row;
} core_chunk;

typedef struct {
  double metres_per_unit, box_low[3], box_high[3], origin[3];
  const double* rest; /* rank x 3 */
  uint32_t vertex_count, rank, base_count, face_total, rows_ready, faces_ready;
  uint32_t up_axis; /* 0 unknown, 1 x, 2 y, 3 z */
  uint32_t is_left_handed;
  uint32_t bands, band_ends[CORE_MAX_BANDS];
  uint32_t has_detail, has_splats;
  const uint8_t* colours; /* rows_ready x 3, sRGB; null: none */
  const uint8_t* image;   /* a PNG or JPEG; null: none (yet) */
  uint32_t image_bytes;
  const char* name;       /* zero-terminated UTF-8 */
  double area;            /* of the surface, or of what its points stand for; surface units squared */
  uint32_t has_columns;   /* that its stream has learnt: beside the chunks */
  const uint32_t* map;    /* rows_ready: of each row from q on the one that it contracts to */
  const uint8_t* normals; /* rows_ready: the file's own: 0 none, 1 smooth, 2 hard; null: none */
} core_facts;

typedef struct {
  int16_t* integers;    /* rows x columns, row-major */
  float* column_scales; /* columns */
  uint32_t columns;
} core_basis;

/* id  32 bytes that the manifest must hash to
   bands  how many of the lowest are wanted; 0: all. With fewer, chunks are complete after needed_bytes
   max_bytes  what the whole asset may take; more is refused as too-large */
core_asset* CORE(asset_open)(const uint8_t* id, const uint8_t* manifest, uint32_t size, uint32_t bands,
                             double max_bytes);
void CORE(asset_free)(core_asset* asset);
uint32_t CORE(asset_chunk_count)(const core_asset* asset);
/* Null beyond the last. */
const core_chunk* CORE(asset_chunk)(core_asset* asset, uint32_t index);
/* Chunks come in order, each whole or its first needed_bytes. After an error nothing has changed. */
int32_t CORE(asset_add)(core_asset* asset, uint32_t index, const uint8_t* bytes, uint32_t size);
/* Makes room for columns that the asset's stream has learnt, which the caller writes behind the others, as one band
   more. All chunks must be there, with fewer than CORE_MAX_BANDS. Surfaces take it for another asset. */
const core_basis* CORE(asset_widen)(core_asset* asset, uint32_t columns);
const core_facts* CORE(asset_facts)(core_asset* asset);
/* The number in the source of a vertex that has arrived, or of the one that a drawn vertex with UVs stands for;
   2^32 - 1: it has not. */
uint32_t CORE(asset_source)(const core_asset* asset, uint32_t vertex, uint32_t is_textured);
/* Rows of bands that did not come become those of the rest pose, in coefficients of rank x channels.
   Errors: invalid-argument (another size, fewer than 3 channels). */
int32_t CORE(asset_fill)(const core_asset* asset, double* coefficients, uint32_t count, uint32_t channels,
                         uint32_t bands);

/* ---- Surfaces: coefficients to positions, normals and triangles at a level of detail ---- */

typedef struct core_surface core_surface;

typedef struct {
  const float *positions, *normals; /* vertices x 3 each; normals null: a cloud without discs */
  const float* radii;               /* vertices, of a cloud's discs; null otherwise */
  const uint32_t* triangles;        /* indices: three a triangle, all below vertices */
  uint32_t vertices, indices;
  uint32_t triangles_version; /* grows when triangles, radii or uvs change */
  uint32_t level;             /* of the surface's vertices; where an image has seams more are drawn */
  const float* uvs;           /* vertices x 2; below -1e30: not in the image. Null: not textured */
  const uint32_t* origins;    /* vertices, where it is textured: which of the surface's each one is; otherwise null */
  uint32_t is_moving;         /* 1: between levels, so that the same pose will look otherwise */
} core_geometry;

core_surface* CORE(surface_make)(void);
void CORE(surface_free)(core_surface* surface);
/* Takes what of the asset has arrived since; another asset starts anew. */
int32_t CORE(surface_update)(core_surface* surface, const core_asset* asset);
/* The asset as of the last surface_update.
   coefficients  rank x channels, or fewer rows; rank_used: the first so many rows of them count, 0: all
   level         vertices; clamped to base_count and what has arrived
   is_textured   with UVs, where the surface has an image
   px_per_unit   pixels of the screen for a unit of a mesh: vertices come and go at a pace, at `level` once they have
                 (common/reconstruction/level_morph); 0: at once
   now_us        of the caller's clock */
const core_geometry* CORE(surface_rebuild)(core_surface* surface, const core_asset* asset, const double* coefficients,
                                           uint32_t count, uint32_t channels, uint32_t rank_used, uint32_t level,
                                           uint32_t is_textured, double px_per_unit, int64_t now_us);

typedef struct {
  const float* values; /* of each of the geometry's `level` vertices */
  float low, high;     /* of the finite ones without the outermost hundredths */
  uint32_t has_range;  /* 0: none is finite */
} core_numbers;

/* Numbers of the vertices of the last surface_rebuild, from coefficients of rank x 3: the length of each vertex's
   vector, or its first entry. */
const core_numbers* CORE(surface_numbers)(core_surface* surface, const core_asset* asset, const double* coefficients,
                                          uint32_t count, uint32_t is_length);

/* Where vertices are in a pose, by their numbers in the source: 3 floats each, NaN for what has not arrived. As
   surface_rebuild, which it leaves alone. */
const float* CORE(surface_points)(core_surface* surface, const core_asset* asset, const double* coefficients,
                                  uint32_t count, uint32_t channels, const uint32_t* vertices, uint32_t points);

/* ---- Columns that streams learn (docs/asset-format.md): eigencast-columns.wasm, a module of its own ---- */

typedef struct core_columns core_columns;

typedef struct {
  const float* scales;   /* count */
  const int16_t* values; /* vertices x count, row-major */
  uint32_t count;
} core_learnt;

/* What an asset's manifest says of them; null: there are none, or it cannot be read. */
core_columns* CORE(columns_open)(const uint8_t* manifest, uint32_t size);
void CORE(columns_free)(core_columns* columns);
/* Their bytes, as a chunk without rows. */
const core_chunk* CORE(columns_section)(core_columns* columns);
/* map: of the whole asset, core_facts. Errors: corrupt, too-large, unsupported. */
const core_learnt* CORE(columns_read)(core_columns* columns, const uint8_t* section, uint32_t size,
                                      const uint32_t* map);

/* ---- Levels: how many vertices surfaces get, and how pictures are drawn, to be in time (common/levels) ---- */

typedef struct core_levels core_levels;

typedef struct {
  double distance, pixels, vertex_cost; /* from the eye; diameter on the screen, 0: out of sight; relative, > 0 */
  uint32_t max, min, drawn, reserved;   /* vertices: that can be drawn, that must be, that were (0: as resolved) */
} core_object;

/* pictures_per_second  wanted, 1 to 1000
   deadline  in times of a picture's: 1 for a display, where a late picture waits for the next refresh */
core_levels* CORE(levels_make)(double pictures_per_second, double deadline);
void CORE(levels_free)(core_levels* levels);
/* Vertices of each object; null: more than 4,096 objects, or one that is out of range.
   seconds  of work that the last picture took, without waiting; not a number or 0: none yet */
const uint32_t* CORE(levels_resolve)(core_levels* levels, const core_object* objects, uint32_t count, int64_t now_us,
                                     double seconds);
/* The planned work of the last picture, as a part of its time. */
double CORE(levels_state)(const core_levels* levels);
/* Of the next picture: the part of its pixels along each side, 1 down to 0.5; 0: several samples a pixel, 1: one;
   0: the whole shadow, 1: of half the texels. */
double CORE(levels_resolution)(const core_levels* levels);
uint32_t CORE(levels_samples)(const core_levels* levels);
uint32_t CORE(levels_shadow)(const core_levels* levels);

#ifdef __cplusplus
}
#endif

#endif
