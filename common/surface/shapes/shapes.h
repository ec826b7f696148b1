// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "common/surface/motion_clip.h"

namespace eigencast {

std::vector<std::string> builtin_names();

/// A built-in shape with its motion, made in code; the same bits on every run.
///   sphere  icosphere, radius 1, 10,242 vertices; wobbles in low modes
///   torus   radii 1 and 0.4; a wave runs round it
///   bar     a closed box of 40 x 40 x 185 quads: exactly 32,802 vertices, 65,600 faces; twists, bends or both, after
///           Zhang et al. 2013, "Streaming 3D deforming surfaces with dynamic resolution control", Figure 2
///   heart   an implicit heart, meshed (about 7,300 vertices; "heart:fine" about 56,000); beats
/// One turn of the motion is periodic, so that it can loop. Y is up.
///   frame_rate_hz  above 0, at most 1000: poses per second of the clip; a turn takes 1 s (heart) to 4 s (bar)
/// Errors: kNotFound, listing the names; kInvalidArgument (rate).
Result<std::unique_ptr<MotionClip>> builtin_clip(std::string_view name, double frame_rate_hz = 30);

/// Unit shapes for tests: closed, manifold, outward oriented, centred at the origin.
Surface make_icosphere(int subdivisions);  ///< 10*4^s + 2 vertices on the unit sphere; s >= 0
/// A torus round the Y axis, around x across vertices; around, across >= 3, major > minor > 0.
Surface make_torus(int around, int across, double major, double minor);
Surface make_box(int nx, int ny, int nz, Vec3 size);  ///< a closed box of nx x ny x nz quads, each split in two
/// Taubin's heart, 10 f^2 + 2 vertices for frequency f >= 1, triangles relaxed to even size. Tip down, width along X.
Surface make_heart(int frequency);

}  // namespace eigencast
