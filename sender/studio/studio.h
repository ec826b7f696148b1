// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "sdk/publisher.h"
#include "sdk/subscriber.h"
#include "sender/deform/projected.h"
#include "sender/studio/local_surface.h"
#include "sender/studio/painter.h"

namespace eigencast::studio {

struct Options {
  std::string title;
  int width = 1280, height = 800;
  std::string view = "front";            ///< See Camera::set_view.
  std::vector<SubscriberOptions> watch;  ///< Streams of others.
  double rate_hz = 60;                   ///< Most poses a second.
  double duration_s = 0;                 ///< 0: until the window is closed.
};

struct Report {
  PaintingReport painting;
  Histogram input_to_coefficients_us;      ///< From the hand to what is sent.
  Histogram input_to_sent_us;              ///< From the hand to the connection, where the pace let the pose go at once.
  Histogram input_to_pose_us;              ///< From the hand to vertices and normals in full detail, ready to be drawn.
  double rms = 0, max = 0;                 ///< Of the last pose: see LocalSurface.
  std::uint64_t poses = 0, held_back = 0;  ///< Made by hand; of those, how many waited for the pace or were overtaken.
};

/// Whether there is a display to open a window on; its graphics may still not do. Call from the main thread. Errors:
/// kUnsupported.
Result<void> find_display();

/// A window in which a hand deforms a surface, which goes out while it does. Returns when the window is closed, the
/// time is over or stop() says so.
///   deformer   has a linear map, or makes coefficients
/// All must outlive the call. Call from the main thread. Errors: kUnsupported (no display, no OpenGL), kInvalidArgument
/// (a URL).
Result<Report> run(const Options& options, deform::Deformer& deformer, deform::ProjectedDeformer& projected,
                   const Asset& asset, Publisher& publisher, const std::function<bool()>& stop, const LogSink& log);

}  // namespace eigencast::studio
