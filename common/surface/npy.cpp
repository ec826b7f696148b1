// SPDX-License-Identifier: MIT
#include "common/surface/npy.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string_view>
#include <system_error>

#include "common/surface/file_text.h"

namespace eigencast {
namespace {

static_assert(std::endian::native == std::endian::little, "values are copied as they stand in the file");

constexpr std::size_t kMaxHeaderBytes = 64 * 1024;
constexpr std::size_t kMaxDimension = std::size_t{1} << 40;

// The text behind 'key': in the header's Python dictionary, without leading blanks.
std::optional<std::string_view> value_of_key(std::string_view header, std::string_view key) {
  for (const char quote : {'\'', '"'}) {
    const std::string quoted_key = quote + std::string(key) + quote;
    const std::size_t at = header.find(quoted_key);
    if (at == std::string_view::npos) continue;
    std::string_view rest = header.substr(at + quoted_key.size());
    const std::size_t colon = rest.find_first_not_of(' ');
    if (colon == std::string_view::npos || rest[colon] != ':') return std::nullopt;
    rest.remove_prefix(colon + 1);
    rest.remove_prefix(std::min(rest.find_first_not_of(' '), rest.size()));
    return rest;
  }
  return std::nullopt;
}

// "(48, 8431, 3)" or "(3,)".
std::optional<std::vector<std::size_t>> shape_from_text(std::string_view text) {
  const std::size_t close = text.find(')');
  if (text.empty() || text[0] != '(' || close == std::string_view::npos) return std::nullopt;
  text = text.substr(1, close - 1);
  std::vector<std::size_t> shape;
  while (!text.empty()) {
    const std::size_t comma = std::min(text.find(','), text.size());
    std::string_view item = text.substr(0, comma);
    text.remove_prefix(std::min(comma + 1, text.size()));
    const std::string_view token = text::take_token(item);
    if (token.empty() && text.empty()) break;
    const auto value = text::integer_from_token(token);
    if (!value || *value < 0 || static_cast<std::uint64_t>(*value) > kMaxDimension || shape.size() == 8) {
      return std::nullopt;
    }
    shape.push_back(static_cast<std::size_t>(*value));
  }
  return shape;
}

template <typename T>
T value_at(const std::string& bytes, std::size_t index) {
  T value;
  std::memcpy(&value, bytes.data() + index * sizeof(T), sizeof(T));
  return value;
}

}  // namespace

Result<NpyFile> NpyFile::open(const std::string& path) {
  std::error_code code;
  const auto status = std::filesystem::status(path, code);
  if (!std::filesystem::exists(status)) return fail(ErrorCode::kNotFound, path + ": no such file");
  if (!std::filesystem::is_regular_file(status)) return fail(ErrorCode::kIo, path + ": not a regular file");
  const std::uint64_t file_bytes = std::filesystem::file_size(path, code);
  std::ifstream in(path, std::ios::binary);
  if (code || !in) return fail(ErrorCode::kIo, path + ": cannot be opened; is reading it allowed?");

  const auto corrupt = [&path](const std::string& what) { return fail(ErrorCode::kCorrupt, path + ": " + what); };
  char start[12] = {};
  in.read(start, 10);
  if (in.gcount() != 10 || std::memcmp(start, "\x93NUMPY", 6) != 0) return corrupt("not an .npy file");
  const int version = static_cast<unsigned char>(start[6]);
  if (version < 1 || version > 3) return fail(ErrorCode::kUnsupported, path + ": .npy of an unknown version");
  const auto byte = [&start](std::size_t i) { return std::size_t{static_cast<unsigned char>(start[i])}; };
  std::size_t header_bytes = byte(8) | byte(9) << 8;
  NpyFile file;
  file.path_ = path;
  file.data_offset_ = 10;
  if (version > 1) {
    in.read(start + 10, 2);
    header_bytes |= byte(10) << 16 | byte(11) << 24;
    file.data_offset_ = 12;
  }
  if (!in || header_bytes > kMaxHeaderBytes) return corrupt("the header is cut off or too long");
  std::string header(header_bytes, '\0');
  in.read(header.data(), static_cast<std::streamsize>(header_bytes));
  if (in.gcount() != static_cast<std::streamsize>(header_bytes)) return corrupt("the header is cut off");
  file.data_offset_ += header_bytes;

  const auto descr = value_of_key(header, "descr");
  const auto order = value_of_key(header, "fortran_order");
  const auto shape_text = value_of_key(header, "shape");
  if (!descr || !order || !shape_text) return corrupt("the header lacks descr, fortran_order or shape");
  if (order->substr(0, 5) != "False") {
    return fail(ErrorCode::kUnsupported, path + ": Fortran order; save numpy.ascontiguousarray(...)");
  }
  bool known = false;
  for (const std::string_view type : {"<f4", "<f8", "<i4", "<i8", "<u4", "<u8"}) {
    if (descr->substr(1, 3) != type || descr->substr(4, 1) != descr->substr(0, 1)) continue;
    file.kind_ = type[1];
    file.item_bytes_ = static_cast<std::size_t>(type[2] - '0');
    known = true;
  }
  if (!known) {
    return fail(ErrorCode::kUnsupported,
                path + ": type " + text::quoted(descr->substr(0, descr->find(','))) +
                    "; float32, float64, int32, uint32, int64 and uint64, little-endian, can be read");
  }
  const auto shape = shape_from_text(*shape_text);
  if (!shape || shape->empty()) return corrupt("the shape in its header cannot be read");
  if (shape->size() > 3) return fail(ErrorCode::kUnsupported, path + ": more than three dimensions");
  file.shape_ = *shape;

  const std::uint64_t items_there = (file_bytes - std::min(file_bytes, file.data_offset_)) / file.item_bytes_;
  std::uint64_t items = 1;
  for (const std::size_t extent : file.shape_) {
    if (extent != 0 && items > items_there / extent) {
      return corrupt("the header claims more values than the " + std::to_string(items_there) + " that are there");
    }
    items *= extent;
  }
  if (file_bytes != file.data_offset_ + items * file.item_bytes_) {
    return corrupt("the file has " + std::to_string(file_bytes) + " bytes, its header makes it " +
                   std::to_string(file.data_offset_ + items * file.item_bytes_));
  }
  return file;
}

Result<std::string> NpyFile::read_bytes(std::size_t first_row, std::size_t rows) const {
  std::ifstream in(path_, std::ios::binary);
  std::string bytes(rows * 3 * item_bytes_, '\0');
  in.seekg(static_cast<std::streamoff>(data_offset_ + std::uint64_t{first_row} * 3 * item_bytes_));
  in.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!in) return fail(ErrorCode::kIo, path_ + ": cannot be read any more; has it changed?");
  return bytes;
}

Result<std::vector<Vec3>> NpyFile::read_positions(std::size_t first, std::size_t count) const {
  assert(!shape_.empty() && shape_.back() == 3);
  if (kind_ != 'f') return fail(ErrorCode::kUnsupported, path_ + ": positions need a float type");
  const auto bytes = read_bytes(first, count);
  if (!bytes) return bytes.error();
  std::vector<Vec3> positions(count);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      const double x = item_bytes_ == 8 ? value_at<double>(*bytes, 3 * i + c) : value_at<float>(*bytes, 3 * i + c);
      if (!std::isfinite(x)) {
        return fail(ErrorCode::kCorrupt, path_ + ": row " + std::to_string(first + i) + " is not finite");
      }
      positions[i][c] = x;
    }
  }
  return positions;
}

Result<std::vector<Face>> NpyFile::read_faces() const {
  if (shape_.size() != 2 || shape_[1] != 3 || kind_ == 'f') {
    return fail(ErrorCode::kUnsupported, path_ + ": faces are an (F, 3) array of integers");
  }
  if (shape_[0] > kMaxSurfaceFaces) {
    return fail(ErrorCode::kTooLarge, path_ + ": more than " + std::to_string(kMaxSurfaceFaces) + " faces");
  }
  const auto bytes = read_bytes(0, shape_[0]);
  if (!bytes) return bytes.error();
  std::vector<Face> faces(shape_[0]);
  for (std::size_t i = 0; i < faces.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      // As unsigned, a negative index is too large.
      const std::size_t at = 3 * i + c;
      const std::uint64_t index =
          item_bytes_ == 8 ? value_at<std::uint64_t>(*bytes, at) : value_at<std::uint32_t>(*bytes, at);
      if (index >= kMaxSurfaceVertices) {
        return fail(ErrorCode::kCorrupt, path_ + ": face " + std::to_string(i) + " has an index that is none");
      }
      faces[i][c] = static_cast<std::uint32_t>(index);
    }
  }
  return faces;
}

}  // namespace eigencast
