// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <type_traits>
#include <utility>

#include "common/core/text.h"
#include "common/surface/formats/binary_file.h"
#include "common/surface/formats/file_text.h"
#include "common/surface/formats/parsed_mesh.h"
#include "common/surface/vertex_normals.h"

namespace eigencast {
namespace {

struct Scalar {
  std::string_view name, other_name;
  std::size_t bytes;
  bool is_float;
  double (*little_endian)(const char*);
  double (*big_endian)(const char*);
};

template <typename T>
constexpr Scalar scalar(std::string_view name, std::string_view other_name) {
  return {name,
          other_name,
          sizeof(T),
          std::is_floating_point_v<T>,
          [](const char* bytes) -> double { return scalar_at<T>(bytes); },
          [](const char* bytes) -> double { return scalar_at<T, true>(bytes); }};
}

constexpr Scalar kScalars[] = {scalar<std::int8_t>("char", "int8"),    scalar<std::uint8_t>("uchar", "uint8"),
                               scalar<std::int16_t>("short", "int16"), scalar<std::uint16_t>("ushort", "uint16"),
                               scalar<std::int32_t>("int", "int32"),   scalar<std::uint32_t>("uint", "uint32"),
                               scalar<float>("float", "float32"),      scalar<double>("double", "float64")};

// Null where there is none.
const Scalar* scalar_from_name(std::string_view name) {
  const auto* at = std::find_if(std::begin(kScalars), std::end(kScalars),
                                [&](const Scalar& s) { return s.name == name || s.other_name == name; });
  return at != std::end(kScalars) ? at : nullptr;
}

struct Property {
  std::string name;
  const Scalar* scalar = nullptr;
  const Scalar* list_count = nullptr;  // set: a list
};

struct Element {
  std::string name;
  std::uint64_t count = 0;
  std::vector<Property> properties;
};

enum class Encoding { kText, kLittle, kBig };

class Body {
 public:
  Body(std::string_view bytes, Encoding encoding) : rest_(bytes), encoding_(encoding) {}

  std::size_t bytes_left() const { return rest_.size(); }

  // Nothing at the end of the file or where a token is not a number.
  std::optional<double> take(const Scalar& scalar) {
    if (encoding_ == Encoding::kText) return number_from_token(text::take_token(rest_));
    if (rest_.size() < scalar.bytes) return std::nullopt;
    const char* bytes = rest_.data();
    rest_.remove_prefix(scalar.bytes);
    return (encoding_ == Encoding::kBig ? scalar.big_endian : scalar.little_endian)(bytes);
  }

 private:
  // Unused properties may be nan or inf also in text.
  static std::optional<double> number_from_token(std::string_view token) {
    if (const auto value = text::coordinate_from_token(token)) return value;
    const std::string_view bare = token.substr(!token.empty() && (token[0] == '-' || token[0] == '+') ? 1 : 0);
    if (bare == "nan" || bare == "inf" || bare == "NaN" || bare == "Inf" || bare == "NAN" || bare == "INF") {
      return std::numeric_limits<double>::quiet_NaN();
    }
    return std::nullopt;
  }

  std::string_view rest_;
  Encoding encoding_;
};

/// A strip of triangles: each vertex makes one with the two before it, turned every other time. Those of two vertices
/// join strips, and are nothing.
struct Strip {
  std::uint32_t before = 0, last = 0, count = 0;

  void add(std::uint32_t vertex, std::vector<Face>& faces) {
    if (++count > 2 && before != last && last != vertex && vertex != before) {
      faces.push_back(count % 2 == 1 ? Face{before, last, vertex} : Face{last, before, vertex});
    }
    before = std::exchange(last, vertex);
  }
};

class PlyParser {
 public:
  explicit PlyParser(std::string_view bytes) : bytes_(bytes) {}

  Result<ParsedMesh> run() {
    if (bytes_.empty()) return fail(ErrorCode::kCorrupt, "the file is empty");
    if (const auto header = take_header(); !header) return header.error();
    if (const auto layout = check_layout(); !layout) return layout.error();
    Body body(bytes_, encoding_);
    for (const Element& element : elements_) {
      // Elements after the last that is used need not be there in full.
      if (&element == end_of_use_) break;
      for (std::uint64_t i = 0; i < element.count; ++i) {
        if (const auto taken = take_record(body, element, i); !taken) return taken.error();
      }
    }
    if (const auto indices = check_indices(); !indices) return indices.error();
    std::span<const std::uint32_t> corners(corners_);
    for (const std::uint32_t count : corner_counts_) {
      add_fan(corners.first(count), mesh_.surface.faces);
      corners = corners.subspan(count);
    }
    resolve_normals();
    return finished(std::move(mesh_));
  }

 private:
  // Ends the header. A \r before binary data that starts with \n cannot be distinguished from \r\n.
  std::optional<std::string_view> header_line() {
    const std::size_t end = bytes_.find_first_of("\r\n");
    if (end == std::string_view::npos) return std::nullopt;
    const std::string_view line = bytes_.substr(0, end);
    bytes_.remove_prefix(end + (bytes_.substr(end, 2) == "\r\n" ? 2 : 1));
    ++line_number_;
    return line;
  }

  Error corrupt(const std::string& what) const { return text::corrupt_at(line_number_, what); }

  Result<void> take_header() {
    auto line = header_line();
    std::string_view rest = line.value_or("");
    if (text::take_token(rest) != "ply") return fail(ErrorCode::kCorrupt, "line 1: a PLY file starts with ply");
    bool has_format = false;
    while ((line = header_line())) {
      rest = *line;
      const std::string_view keyword = text::take_token(rest);
      if (keyword == "end_header") {
        if (has_format) return {};
        return corrupt("the header has no format");
      }
      Result<void> taken;
      if (keyword == "format") {
        taken = take_format(rest);
        has_format = true;
      } else if (keyword == "element") {
        taken = take_element(rest);
      } else if (keyword == "property") {
        taken = take_property(rest);
      } else if (keyword != "comment" && keyword != "obj_info" && !keyword.empty()) {
        taken = corrupt("the header says " + text::quoted(keyword) + ", which is not PLY");
      }
      if (!taken) return taken;
    }
    return corrupt("the file ends inside its header");
  }

  Result<void> take_format(std::string_view rest) {
    const std::string_view name = text::take_token(rest);
    constexpr std::array<std::string_view, 3> kNames{"ascii", "binary_little_endian", "binary_big_endian"};
    const auto at = std::find(kNames.begin(), kNames.end(), name);
    if (at == kNames.end()) return corrupt("format " + text::quoted(name) + " is none of PLY's");
    encoding_ = static_cast<Encoding>(at - kNames.begin());
    return {};
  }

  Result<void> take_element(std::string_view rest) {
    Element element;
    element.name = text::take_token(rest);
    const std::string_view token = text::take_token(rest);
    const auto count = text::integer_from_token(token);
    if (!count || *count < 0) return corrupt(text::quoted(token) + " is not a count of elements");
    element.count = static_cast<std::uint64_t>(*count);
    if (elements_.size() >= kMaxElements) return corrupt("more than " + std::to_string(kMaxElements) + " elements");
    elements_.push_back(std::move(element));
    return {};
  }

  Result<void> take_property(std::string_view rest) {
    if (elements_.empty()) return corrupt("a property before any element");
    Element& element = elements_.back();
    if (element.properties.size() >= kMaxProperties) {
      return corrupt("more than " + std::to_string(kMaxProperties) + " properties");
    }
    Property property;
    std::string_view type = text::take_token(rest);
    if (type == "list") {
      const std::string_view count_type = text::take_token(rest);
      property.list_count = scalar_from_name(count_type);
      if (property.list_count == nullptr || property.list_count->is_float) {
        return corrupt(text::quoted(count_type) + " is not a type of a list's length");
      }
      type = text::take_token(rest);
    }
    property.scalar = scalar_from_name(type);
    if (property.scalar == nullptr) return corrupt(text::quoted(type) + " is none of PLY's types");
    property.name = text::take_token(rest);
    element.properties.push_back(std::move(property));
    return {};
  }

  // Finds what is used and holds the counts against the size of the file.
  Result<void> check_layout() {
    for (const Element& element : elements_) {
      std::size_t min_bytes = 0;
      for (const Property& property : element.properties) {
        const Scalar& first = property.list_count != nullptr ? *property.list_count : *property.scalar;
        min_bytes += encoding_ == Encoding::kText ? 2 : first.bytes;
      }
      const bool used = element.name == "vertex" || element.name == "face" || element.name == "tristrips";
      // The last token of a text may lack its blank.
      if (element.count > (bytes_.size() + 1) / std::max<std::size_t>(min_bytes, 1)) {
        return fail(ErrorCode::kCorrupt, "the header claims " + std::to_string(element.count) + " of " +
                                             text::quoted(element.name) + ", more than the " +
                                             std::to_string(bytes_.size()) + " bytes after it can hold");
      }
      if (used) end_of_use_ = &element + 1;
      if (element.name != "vertex") continue;
      has_vertices_ = true;
      has_normals_ = std::any_of(element.properties.begin(), element.properties.end(),
                                 [](const Property& property) { return property.name == "nx"; });
    }
    if (!has_vertices_) return fail(ErrorCode::kCorrupt, "the header has no vertex element");
    if (end_of_use_ == elements_.data() + elements_.size()) end_of_use_ = nullptr;
    return {};
  }

  Result<void> take_record(Body& body, const Element& element, std::uint64_t i) {
    const bool is_vertex = element.name == "vertex";
    const Indices of = element.name == "face"        ? Indices::kPolygon
                       : element.name == "tristrips" ? Indices::kStrips
                                                     : Indices::kNone;
    Vec3 p{};
    unsigned found = 0, coloured = 0;
    std::array<double, 3> colour{};
    std::array<float, 3> normal{};
    for (const Property& property : element.properties) {
      if (property.list_count != nullptr) {
        const bool named = property.name == "vertex_indices" || property.name == "vertex_index";
        if (auto taken = take_list(body, property, element, i, named ? of : Indices::kNone); !taken) return taken;
        continue;
      }
      const auto value = body.take(*property.scalar);
      if (!value) return broken(element, i, property);
      if (is_vertex) coloured |= take_colour(property, *value, colour);
      if (is_vertex) take_normal(property, *value, normal);
      if (!is_vertex || property.name.size() != 1 || property.name[0] < 'x' || property.name[0] > 'z') continue;
      const auto axis = static_cast<std::size_t>(property.name[0] - 'x');
      if (!(std::abs(*value) <= static_cast<double>(std::numeric_limits<float>::max()))) {
        return fail(ErrorCode::kCorrupt,
                    "vertex " + std::to_string(i) + ": " + property.name + " is not a finite number");
      }
      p[axis] = *value;
      found |= 1U << axis;
    }
    if (is_vertex) {
      if (found != 7) return fail(ErrorCode::kCorrupt, "the vertices lack one of x, y, z");
      mesh_.surface.positions.push_back(p);
      if (coloured == 7) mesh_.colours.push_back(colour_from_parts(colour));
      if (has_normals_) normals_.push_back(normal);
    }
    return {};
  }

  // red, green, blue: of 0 to 1 as floats, else of all that the type holds. The bit of the channel, or 0.
  static unsigned take_colour(const Property& property, double value, std::array<double, 3>& colour) {
    constexpr std::array<std::string_view, 3> kChannels{"red", "green", "blue"};
    const auto at = std::find(kChannels.begin(), kChannels.end(), property.name);
    if (at == kChannels.end() || std::isnan(value)) return 0;
    const auto channel = static_cast<std::size_t>(at - kChannels.begin());
    const Scalar& type = *property.scalar;
    colour[channel] = value / (type.is_float ? 1 : std::exp2(8.0 * static_cast<double>(type.bytes)) - 1);
    return 1U << channel;
  }

  // nx, ny, nz; a value that is not a 32-bit number is left out.
  static void take_normal(const Property& property, double value, std::array<float, 3>& normal) {
    constexpr std::array<std::string_view, 3> kAxes{"nx", "ny", "nz"};
    const auto at = std::find(kAxes.begin(), kAxes.end(), property.name);
    if (at == kAxes.end()) return;
    constexpr double kMax = std::numeric_limits<float>::max();
    normal[static_cast<std::size_t>(at - kAxes.begin())] =
        std::abs(value) <= kMax ? static_cast<float>(value) : std::numeric_limits<float>::quiet_NaN();
  }

  enum class Indices { kNone, kPolygon, kStrips };

  Result<void> take_list(Body& body, const Property& property, const Element& element, std::uint64_t i, Indices of) {
    const auto count = body.take(*property.list_count);
    if (!count) return broken(element, i, property);
    // At least a byte a value, so that a lie ends here and not after billions of attempts.
    if (!(*count >= 0 && *count == std::floor(*count)) || *count > static_cast<double>(body.bytes_left())) {
      return fail(ErrorCode::kCorrupt, text::quoted(element.name) + " " + std::to_string(i) + " claims a list of " +
                                           formatted("%.0f", *count) + " values");
    }
    const auto length = static_cast<std::uint64_t>(*count);
    if (of == Indices::kPolygon) {
      if (const auto corners = check_corners(length, 0); !corners) {
        return in_context("face " + std::to_string(i), corners.error());
      }
      corner_counts_.push_back(static_cast<std::uint32_t>(length));
    }
    Strip strip;
    for (std::uint64_t k = 0; k < length; ++k) {
      const auto value = body.take(*property.scalar);
      if (!value) return broken(element, i, property);
      if (of == Indices::kNone) continue;
      if (of == Indices::kStrips && *value == -1) {
        strip = {};
        continue;
      }
      if (!(*value >= 0 && *value < static_cast<double>(kMaxSurfaceVertices) && *value == std::floor(*value))) {
        return fail(ErrorCode::kCorrupt,
                    text::quoted(element.name) + " " + std::to_string(i) + " has an index that is not a vertex");
      }
      const auto corner = static_cast<std::uint32_t>(*value);
      of == Indices::kPolygon ? corners_.push_back(corner) : strip.add(corner, mesh_.surface.faces);
      if (mesh_.surface.faces.size() > kMaxSurfaceFaces) return check_sizes(1, mesh_.surface.faces.size());
    }
    return {};
  }

  static Error broken(const Element& element, std::uint64_t i, const Property& property) {
    return fail(ErrorCode::kCorrupt, text::quoted(element.name) + " " + std::to_string(i) + " of " +
                                         std::to_string(element.count) + ": the file ends, or has no number, at " +
                                         text::quoted(property.name));
  }

  Result<void> check_indices() {
    if (const auto strips = check_values(mesh_.surface); !strips)
      return fail(ErrorCode::kCorrupt, strips.error().message);
    const std::size_t n = mesh_.surface.positions.size();
    std::size_t corner = 0;
    for (std::size_t i = 0; i < corner_counts_.size(); ++i) {
      for (std::uint32_t k = 0; k < corner_counts_[i]; ++k, ++corner) {
        if (corners_[corner] < n) continue;
        return fail(ErrorCode::kCorrupt, "face " + std::to_string(i) + " refers to vertex " +
                                             std::to_string(corners_[corner]) + "; there are " + std::to_string(n) +
                                             ", counted from 0");
      }
    }
    return {};
  }

  // Of vertices: those that a file wants apart are vertices of their own.
  void resolve_normals() {
    const std::size_t n = mesh_.surface.vertex_count();
    if (normals_.size() != n) return;
    VertexNormalsFinder finder(n);
    for (const Face& face : mesh_.surface.faces) {
      for (const std::uint32_t v : face) finder.add_corner(v, {normals_[v][0], normals_[v][1], normals_[v][2]});
    }
    mesh_.normals = finder.take();
  }

  static constexpr std::size_t kMaxElements = 64;
  static constexpr std::size_t kMaxProperties = 256;

  std::string_view bytes_;
  std::size_t line_number_ = 0;
  Encoding encoding_ = Encoding::kText;
  std::vector<Element> elements_;
  const Element* end_of_use_ = nullptr;  // null: all are used
  bool has_vertices_ = false, has_normals_ = false;
  std::vector<std::array<float, 3>> normals_;
  std::vector<std::uint32_t> corners_;
  std::vector<std::uint32_t> corner_counts_;
  ParsedMesh mesh_;
};

}  // namespace

Result<ParsedMesh> parse_ply(std::string_view bytes) {
  return PlyParser(bytes).run();
}

}  // namespace eigencast
