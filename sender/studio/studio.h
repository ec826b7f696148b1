// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "sdk/publisher.h"
#include "sdk/subscriber.h"
#include "sender/deform/deformer.h"
#include "sender/studio/local_surface.h"
#include "sender/studio/painter.h"

namespace eigencast::studio {

struct Options {
  std::string title;
  int width = 1280, height = 800;
  std::string view = "front";            ///< See Camera::set_view.
  std::vector<SubscriberOptions> watch;  ///< Streams of others.
  double rate_hz = 60;                   ///< Upper bound of sent poses a second.
  double duration_s = 0;                 ///< 0: until the window is closed.
};

struct Report {
  PaintingReport painting;
  Histogram input_to_coefficients_us;      ///< From input to coefficients.
  Histogram input_to_sent_us;              ///< From input to the connection, of poses that were sent at once.
  Histogram input_to_pose_us;              ///< From input to vertices and normals in full detail.
  double rms = 0, max = 0;                 ///< For the last pose: see LocalSurface.
  std::uint64_t poses = 0, held_back = 0;  ///< Made by hand; of those, delayed by the pace or overtaken.
};

/// It may lack OpenGL. Call from the main thread. Errors: kUnsupported.
Result<void> find_display();

/// Returns when the window is closed, the time is over or stop() returns true. All must outlive the call. Call from the
/// main thread. Errors: kUnsupported (no display, no OpenGL), kInvalidArgument (a URL).
///   deformer   has a linear map, or makes coefficients
Result<Report> run(const Options& options, deform::Deformer& deformer, deform::ProjectedDeformer& projected,
                   const Asset& asset, Publisher& publisher, const std::function<bool()>& stop, const LogSink& log);

}  // namespace eigencast::studio
