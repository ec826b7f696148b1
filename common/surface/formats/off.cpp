// SPDX-License-Identifier: MIT
#include <array>
#include <cstdint>
#include <optional>

#include "common/surface/formats/file_text.h"
#include "common/surface/formats/parsed_mesh.h"

namespace eigencast {
namespace {

using text::corrupt_at;
using text::quoted;

class OffParser {
 public:
  explicit OffParser(std::string_view bytes) : size_(bytes.size()), lines_(bytes) {}

  Result<ParsedMesh> run() {
    if (const auto header = take_header(); !header) return header.error();
    if (const auto sizes = check_sizes(vertices_, faces_); !sizes) return sizes.error();
    for (std::size_t i = 0; i < vertices_; ++i) {
      if (const auto taken = take_vertex(i); !taken) return taken.error();
    }
    for (std::size_t i = 0; i < faces_; ++i) {
      if (const auto taken = take_face(i); !taken) return taken.error();
    }
    return finished(std::move(mesh_));
  }

 private:
  std::optional<std::string_view> next_line() {
    while (const auto line = lines_.next()) {
      std::string_view probe = text::without_comment(*line);
      if (!text::take_token(probe).empty()) return text::without_comment(*line);
    }
    return std::nullopt;
  }

  // "[ST][C][N][4][n]OFF [BINARY]", then the counts on the same or the next line.
  Result<void> take_header() {
    auto line = next_line();
    if (!line) return fail(ErrorCode::kCorrupt, "the file is empty");
    std::string_view rest = *line;
    std::string_view kind = text::take_token(rest);
    if (kind.substr(0, 2) == "ST") kind.remove_prefix(2);
    has_colours_ = kind.substr(0, 1) == "C";
    if (has_colours_) kind.remove_prefix(1);
    has_normals_ = kind.substr(0, 1) == "N";
    if (has_normals_) kind.remove_prefix(1);
    if (kind == "4OFF" || kind == "nOFF" || kind == "4nOFF") {
      return fail(ErrorCode::kUnsupported, "OFF of other than three dimensions");
    }
    if (kind != "OFF") return corrupt_at(lines_.number(), "an OFF file starts with OFF, not " + quoted(*line));
    std::string_view probe = rest;
    const std::string_view second = text::take_token(probe);
    if (second == "BINARY") return fail(ErrorCode::kUnsupported, "binary OFF; save it as text, or as PLY");
    if (second.empty()) {
      line = next_line();
      if (!line) return corrupt_at(lines_.number(), "the file ends before the counts of vertices and faces");
      rest = *line;
    }
    if (const auto good = store(vertices_, take_count(rest, "vertices")); !good) return good;
    return store(faces_, take_count(rest, "faces"));
  }

  // Nothing is allocated for more than the file can hold: a vertex or face takes at least five bytes, "0 0 0".
  Result<std::size_t> take_count(std::string_view& rest, const std::string& what) {
    const std::string_view token = text::take_token(rest);
    const auto count = text::integer_from_token(token);
    if (!count || *count < 0) return corrupt_at(lines_.number(), quoted(token) + " is not a count of " + what);
    if (static_cast<std::uint64_t>(*count) > size_ / 5) {
      return corrupt_at(lines_.number(), "the header claims " + std::to_string(*count) + " " + what +
                                             ", more than the file's " + std::to_string(size_) + " bytes can hold");
    }
    return static_cast<std::size_t>(*count);
  }

  Result<void> take_vertex(std::size_t i) {
    auto line = next_line();
    if (!line) return ended("vertex", i, vertices_);
    const auto p = text::take_position(*line, lines_.number(), "vertex " + std::to_string(i));
    if (!p) return p.error();
    mesh_.surface.positions.push_back(*p);
    if (has_colours_) take_colour(*line);
    return {};
  }

  // After a normal, if there is one: whole numbers of 0 to 255, or numbers with a point of 0 to 1.
  void take_colour(std::string_view rest) {
    for (int k = 0; has_normals_ && k < 3; ++k) text::take_token(rest);
    std::array<double, 3> parts{};
    for (double& part : parts) {
      const std::string_view token = text::take_token(rest);
      const auto value = text::coordinate_from_token(token);
      if (!value) return;
      part = text::integer_from_token(token) ? *value / 255 : *value;
    }
    mesh_.colours.push_back(colour_from_parts(parts));
  }

  Result<void> take_face(std::size_t i) {
    auto line = next_line();
    if (!line) return ended("face", i, faces_);
    const std::string_view first = text::take_token(*line);
    const auto count = text::integer_from_token(first);
    if (!count || *count < 0) return corrupt_at(lines_.number(), quoted(first) + " is not a number of corners");
    const auto corners = static_cast<std::uint64_t>(*count);
    if (auto checked = check_corners(corners, lines_.number()); !checked) return checked;
    corners_.clear();
    for (std::uint64_t k = 0; k < corners; ++k) {
      const std::string_view token = text::take_token(*line);
      const auto index = text::integer_from_token(token);
      if (!index || *index < 0 || *index >= static_cast<std::int64_t>(vertices_)) {
        return corrupt_at(lines_.number(), "face " + std::to_string(i) + " refers to vertex " + quoted(token) +
                                               "; there are " + std::to_string(vertices_) + ", counted from 0");
      }
      corners_.push_back(static_cast<std::uint32_t>(*index));
    }
    add_fan(corners_, mesh_.surface.faces);
    return {};
  }

  Error ended(const char* what, std::size_t i, std::size_t count) const {
    return corrupt_at(lines_.number(), std::string("the file ends before ") + what + " " + std::to_string(i) + " of " +
                                           std::to_string(count));
  }

  std::size_t size_;
  text::Lines lines_;
  std::size_t vertices_ = 0;
  std::size_t faces_ = 0;
  bool has_colours_ = false, has_normals_ = false;
  std::vector<std::uint32_t> corners_;  // of the face at hand
  ParsedMesh mesh_;
};

}  // namespace

Result<ParsedMesh> parse_off(std::string_view bytes) {
  return OffParser(bytes).run();
}

}  // namespace eigencast
