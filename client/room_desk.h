// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/rewind_desk.h"
#include "client/viewer_state.h"
#include "sdk/room.h"
#include "view/camera.h"
#include "view/pose_source.h"
#include "view/scene.h"

namespace eigencast {

/// A point that rides on a surface: within three vertices, by their numbers in the sender's own surface, so that it is
/// the same at every level of detail and in every basis.
struct SurfacePoint {
  std::string stream;
  std::array<std::uint32_t, 3> corners{};
  glm::vec3 weights{0};  ///< Barycentric; their sum is 1.
};

// What members say (docs/protocol.md, "room"). Safe on hostile text; nothing: it is none.
std::string text_from_point(const SurfacePoint& point, const std::string& note = {});
std::optional<SurfacePoint> point_from_text(const std::string& json, std::string* note = nullptr);

/// What the viewer does in a room: follows the one who leads, or leads; points; pins notes to surfaces. Not
/// thread-safe.
class RoomDesk final {
 public:
  static constexpr std::size_t kMaxNoteBytes = 500;
  static constexpr const char* kLead = "lead";

  explicit RoomDesk(std::unique_ptr<RoomClient> client) : client_(std::move(client)) {}

  /// Once a turn: takes news, moves the camera after the one who leads, or says where it is. True: the picture changes.
  bool advance(Camera& camera, TimeUs now_us);
  /// Says where in time the one who leads is, or goes there.
  void share(RewindDesk& rewind, std::span<PoseSource* const> sources);
  /// The user has moved the camera. If somebody leads, the camera stops following, also later leaders, until follow().
  void stop_following() { follows_ = follows_ && (leads() || state_.holder_of(kLead) == nullptr); }
  bool follows() const { return follows_; }
  void follow() { follows_ = true; }
  bool leads() const;
  void lead(bool take);

  /// Where the user points; nothing: nowhere.
  void point_at(const std::optional<SurfacePoint>& point);
  void pin(const SurfacePoint& point, std::string note);

  struct Pin {
    std::uint32_t member = 0;
    std::string key, note;
    bool removable = false;  ///< By oneself.
  };
  /// Of what is shown.
  std::vector<Pin> pins(std::span<PoseSource* const> sources) const;
  void remove(const Pin& pin);

  /// What is drawn over the picture, at a place of the scene.
  struct Mark {
    glm::vec3 at{0};
    std::array<std::uint8_t, 3> colour{};
    std::string text;
    bool is_pin = false;
  };
  std::vector<Mark> marks(const Scene& scene, std::span<PoseSource* const> sources);
  /// Of a hit of pick(); nothing: its stream is not known.
  static std::optional<SurfacePoint> point_of(const Hit& hit, const Scene& scene, std::span<PoseSource* const> sources);

  const RoomState& state() const { return state_; }

 private:
  /// Rows of an asset by the source's numbers.
  struct Rows {
    std::uint32_t epoch = 0, ready = 0;
    std::vector<std::uint32_t> row_of;
  };
  /// A pin, or where another points.
  struct Said {
    std::uint32_t member = 0;
    std::string key, note;
    SurfacePoint point;
    bool is_pin = false;
  };
  void find_points();
  const Rows& rows_of(std::size_t source, const PoseSource& from);

  std::unique_ptr<RoomClient> client_;
  RoomState state_;
  std::vector<Said> points_;  ///< Of state_, parsed once.
  bool follows_ = true;
  std::string said_camera_, said_seek_ = "null", heard_seek_;
  struct Goal {
    std::string text;
    glm::vec3 eye{0}, target{0};
  };
  std::optional<Goal> goal_;
  TimeUs moved_us_ = 0;
  std::map<std::size_t, Rows> rows_;
  std::vector<float> room_;
};

std::array<std::uint8_t, 3> colour_from_text(const std::string& colour);  ///< "#rrggbb"
/// One of eight that are told apart well.
std::string colour_of_name(const std::string& name);

}  // namespace eigencast
