// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tests/unit/surface/temp_dir.h"

namespace eigencast {

/// Puts a small binary glTF file together: numbers become accessors over one buffer, the rest is JSON as it stands.
class Glb {
 public:
  /// An accessor of 32-bit floats; returns its number. type: "VEC3", ...
  int floats(const std::vector<float>& values, const std::string& type, std::size_t width) {
    return accessor(raw(values), 5126, values.size() / width, type);
  }
  int shorts(const std::vector<std::uint16_t>& values, const std::string& type = "SCALAR", std::size_t width = 1,
             const std::string& more = "") {
    return accessor(raw(values), 5123, values.size() / width, type, more);
  }
  /// A buffer view; returns its number.
  int view(const std::string& bytes) {
    views_ += (views_.empty() ? "" : ",") + std::string("{\"buffer\":0,\"byteOffset\":") +
              std::to_string(binary_.size()) + ",\"byteLength\":" + std::to_string(bytes.size()) + "}";
    binary_ += bytes;
    binary_.resize((binary_.size() + 3) / 4 * 4);
    return view_count_++;
  }
  int accessor(const std::string& bytes, int type_of_component, std::size_t count, const std::string& type,
               const std::string& more = "") {
    return accessor_json("\"bufferView\":" + std::to_string(view(bytes)) +
                         ",\"componentType\":" + std::to_string(type_of_component) +
                         ",\"count\":" + std::to_string(count) + ",\"type\":\"" + type + "\"" + more);
  }
  int accessor_json(const std::string& members) {
    accessors_ += (accessors_.empty() ? "{" : ",{") + members + "}";
    return accessor_count_++;
  }

  /// The file, with `members` beside buffers, views and accessors.
  std::string bytes(const std::string& members) const {
    std::string json =
        "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":" + std::to_string(binary_.size()) +
        "}],\"bufferViews\":[" + views_ + "],\"accessors\":[" + accessors_ + "]," + members + "}";
    json.resize((json.size() + 3) / 4 * 4, ' ');
    const auto word = [](std::size_t value) {
      return raw(std::vector<std::uint32_t>{static_cast<std::uint32_t>(value)});
    };
    return "glTF" + word(2) + word(28 + json.size() + binary_.size()) + word(json.size()) + "JSON" + json +
           word(binary_.size()) + std::string("BIN\0", 4) + binary_;
  }

 private:
  std::string binary_, views_, accessors_;
  int view_count_ = 0, accessor_count_ = 0;
};

}  // namespace eigencast
