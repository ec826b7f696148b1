// SPDX-License-Identifier: MIT
#pragma once

#include <string>

namespace eigencast {

struct ClipOptions {
  std::string rest{};       ///< File of the rest pose (default: beside a cache; else the first frame).
  std::string faces{};      ///< Faces of a .npy clip (default: faces.npy beside it).
  std::string animation{};  ///< Name or number of one of a glTF file's animations (default: the first).
  double rate_hz = 30;      ///< Poses a second of formats that state curves instead of poses.
};

}  // namespace eigencast
