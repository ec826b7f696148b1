// SPDX-License-Identifier: MIT
#include "common/surface/formats/npy.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <optional>
#include <string_view>

#include "common/surface/formats/file_text.h"

namespace eigencast {

namespace {

constexpr std::size_t kMaxHeaderBytes = 64 * 1024;
constexpr std::size_t kMaxDimension = std::size_t{1} << 40;
constexpr std::uint64_t kMaxBlockBytes = 32 << 20;

// Converts IEEE 754 binary16.
double double_from_half(std::uint16_t bits) {
  const int exponent = bits >> 10 & 31;
  const double fraction = bits & 1023;
  double value = exponent == 0 ? std::ldexp(fraction, -24) : std::ldexp(1024 + fraction, exponent - 25);
  if (exponent == 31) value = fraction == 0 ? std::numeric_limits<double>::infinity() : std::nan("");
  return (bits & 0x8000) != 0 ? -value : value;
}

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

template <typename T, bool big_endian>
double real_at(const char* bytes) {
  if constexpr (sizeof(T) == 2)
    return double_from_half(scalar_at<std::uint16_t, big_endian>(bytes));
  else
    return scalar_at<T, big_endian>(bytes);
}

// Sign extension makes a negative index larger than any that is allowed.
template <typename T, bool big_endian>
std::uint64_t index_at(const char* bytes) {
  return static_cast<std::uint64_t>(scalar_at<T, big_endian>(bytes));
}

}  // namespace

Result<NpyFile::Type> NpyFile::type_from_descr(std::string_view descr) {
  // "'<f4'": quote, byte order, kind, bytes, quote.
  const auto unknown = [&] {
    return fail(ErrorCode::kUnsupported, "type " + text::quoted(descr.substr(0, descr.find(','))) +
                                             "; real numbers of 2, 4 or 8 bytes and integers can be read");
  };
  const bool whole = descr.size() >= 5 && descr[4] == descr[0] && (descr[0] == '\'' || descr[0] == '"');
  if (!whole || std::string_view("<>|=").find(descr[1]) == std::string_view::npos) return unknown();
  const bool big = descr[1] == '>';
  const std::string_view name = descr.substr(2, 2);
  const auto real = [big]<typename T>(T) {
    return Type{big ? real_at<T, true> : real_at<T, false>, nullptr, sizeof(T)};
  };
  const auto integer = [big]<typename T>(T) {
    return Type{nullptr, big ? index_at<T, true> : index_at<T, false>, sizeof(T)};
  };
  if (name == "f2") return real(std::uint16_t{});
  if (name == "f4") return real(float{});
  if (name == "f8") return real(double{});
  if (name == "i1") return integer(std::int8_t{});
  if (name == "u1") return integer(std::uint8_t{});
  if (name == "i2") return integer(std::int16_t{});
  if (name == "u2") return integer(std::uint16_t{});
  if (name == "i4") return integer(std::int32_t{});
  if (name == "u4") return integer(std::uint32_t{});
  if (name == "i8") return integer(std::int64_t{});
  if (name == "u8") return integer(std::uint64_t{});
  return unknown();
}

Result<NpyFile> NpyFile::open(const std::string& path) {
  NpyFile file;
  if (const auto good = store(file.file_, BinaryFile::open(path)); !good) return good.error();
  const auto corrupt = [&path](const std::string& what) { return fail(ErrorCode::kCorrupt, path + ": " + what); };

  std::string start(static_cast<std::size_t>(std::min<std::uint64_t>(12, file.file_->bytes())), '\0');
  if (const auto read = file.file_->read_at(0, start); !read) return read.error();
  if (start.size() < 12 || start.compare(0, 6, "\x93NUMPY") != 0) return corrupt("not an .npy file");
  const int version = static_cast<unsigned char>(start[6]);
  if (version < 1 || version > 3) return fail(ErrorCode::kUnsupported, path + ": .npy of an unknown version");
  const bool is_short = version == 1;
  const std::size_t header_bytes =
      is_short ? scalar_at<std::uint16_t>(start.data() + 8) : scalar_at<std::uint32_t>(start.data() + 8);
  const std::uint64_t header_offset = is_short ? 10 : 12;
  file.data_offset_ = header_offset + header_bytes;
  if (header_bytes > kMaxHeaderBytes || file.data_offset_ > file.file_->bytes()) {
    return corrupt("the header is cut off or too long");
  }
  std::string header(header_bytes, '\0');
  if (const auto read = file.file_->read_at(header_offset, header); !read) return read.error();

  const auto descr = value_of_key(header, "descr");
  const auto order = value_of_key(header, "fortran_order");
  const auto shape_text = value_of_key(header, "shape");
  if (!descr || !order || !shape_text) return corrupt("the header lacks descr, fortran_order or shape");
  file.fortran_ = order->substr(0, 4) == "True";
  if (!file.fortran_ && order->substr(0, 5) != "False") return corrupt("fortran_order is neither True nor False");
  if (const auto good = store(file.type_, type_from_descr(*descr)); !good) return in_context(path, good.error());
  const auto shape = shape_from_text(*shape_text);
  if (!shape || shape->empty()) return corrupt("the shape in its header cannot be read");
  if (shape->size() < 2 || shape->size() > 3) {
    return fail(ErrorCode::kUnsupported, path + ": an array of " + std::to_string(shape->size()) + " dimensions");
  }
  file.shape_ = *shape;

  const std::uint64_t items_there =
      (file.file_->bytes() - std::min(file.file_->bytes(), file.data_offset_)) / file.type_.bytes;
  std::uint64_t items = 1;
  for (const std::size_t extent : file.shape_) {
    if (extent != 0 && items > items_there / extent) {
      return corrupt("an extent of " + std::to_string(extent) + " claims more values than the " +
                     std::to_string(items_there) + " that are there");
    }
    items *= extent;
  }
  if (file.file_->bytes() != file.data_offset_ + items * file.type_.bytes) {
    return corrupt("the file has " + std::to_string(file.file_->bytes()) + " bytes, its header makes it " +
                   std::to_string(file.data_offset_ + items * file.type_.bytes));
  }
  return file;
}

Result<void> NpyFile::read_block(std::size_t frame) const {
  if (frame >= block_.first && frame - block_.first < block_.count) return {};
  block_.count = 0;
  const std::uint64_t values = rows() * 3;
  const std::uint64_t frame_bytes = values * type_.bytes;
  std::size_t count = 1;
  if (fortran_) {
    count = std::clamp<std::size_t>(kMaxBlockBytes / std::max<std::uint64_t>(1, frame_bytes), 1, frames() - frame);
  }
  block_.first = frame;
  if (count == frames() || !fortran_) {
    block_.bytes.resize(static_cast<std::size_t>(frame_bytes * count));
    const auto read = file_->read_at(data_offset_ + frame * frame_bytes, block_.bytes);
    if (!read) return read;
  } else {
    // One run of frames for each of the 3 n values.
    const std::size_t run_bytes = count * type_.bytes;
    block_.bytes.clear();
    std::string run(run_bytes, '\0');
    for (std::uint64_t value = 0; value < values; ++value) {
      const auto read = file_->read_at(data_offset_ + (value * frames() + frame) * type_.bytes, run);
      if (!read) return read;
      block_.bytes += run;
    }
  }
  block_.count = count;
  return {};
}

Result<std::vector<Vec3>> NpyFile::read_positions(std::size_t frame) const {
  assert(shape_.back() == 3 && frame < frames());
  if (type_.real == nullptr) return fail(ErrorCode::kUnsupported, file_->path() + ": positions need a float type");
  if (const auto read = read_block(frame); !read) return read.error();
  const std::size_t n = rows();
  std::vector<Vec3> positions(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      const std::size_t at = fortran_ ? (i + n * c) * block_.count + (frame - block_.first) : 3 * i + c;
      const double x = type_.real(block_.bytes.data() + at * type_.bytes);
      if (!(std::abs(x) <= static_cast<double>(std::numeric_limits<float>::max()))) {
        return fail(ErrorCode::kCorrupt, file_->path() + ": vertex " + std::to_string(i) + " of frame " +
                                             std::to_string(frame) + " is not finite as a 32-bit float");
      }
      positions[i][c] = x;
    }
  }
  return positions;
}

Result<std::vector<Face>> NpyFile::read_faces() const {
  const std::string& path = file_->path();
  if (shape_.size() != 2 || shape_[1] != 3 || type_.index == nullptr) {
    return fail(ErrorCode::kUnsupported, path + ": faces are an (F, 3) array of integers");
  }
  if (shape_[0] > kMaxSurfaceFaces) {
    return fail(ErrorCode::kTooLarge, path + ": more than " + std::to_string(kMaxSurfaceFaces) + " faces");
  }
  std::string bytes(shape_[0] * 3 * type_.bytes, '\0');
  if (const auto read = file_->read_at(data_offset_, bytes); !read) return read.error();
  std::vector<Face> faces(shape_[0]);
  for (std::size_t i = 0; i < faces.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      const std::size_t at = fortran_ ? i + shape_[0] * c : 3 * i + c;
      const std::uint64_t index = type_.index(bytes.data() + at * type_.bytes);
      if (index >= kMaxSurfaceVertices) {
        return fail(ErrorCode::kCorrupt, path + ": face " + std::to_string(i) + " has an index that is not a vertex");
      }
      faces[i][c] = static_cast<std::uint32_t>(index);
    }
  }
  return faces;
}

}  // namespace eigencast
