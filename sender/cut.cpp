// SPDX-License-Identifier: MIT
#include "sender/cut.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <optional>
#include <set>
#include <string_view>
#include <utility>
#include <variant>

#include "common/core/bytes.h"
#include "common/recording/reader.h"
#include "common/recording/writer.h"
#include "common/wire/control.h"
#include "sdk/asset_folder.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;
using recording::Record;
using recording::Type;

constexpr TimeUs kBetweenFilesUs = 33'333;

std::string_view text_of(const Bytes& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// Writes ranges of recordings after one another. Times of the result run on.
class Cutter {
 public:
  Cutter(recording::Writer writer, const std::function<Result<Bytes>(const Sha256&)>& missing)
      : writer_(std::move(writer)), missing_(missing) {}

  Result<void> copy_objects(recording::Reader& reader) {
    const auto offsets = reader.object_offsets();
    if (!offsets) return offsets.error();
    for (const std::uint64_t offset : *offsets) {
      const auto object = reader.object_at(offset);
      if (!object) return object.error();
      const ByteView bytes = ByteView(object->body).subspan(recording::kIdBytes);
      const Sha256 id = sha256(bytes);
      if (!copied_.insert(id).second) continue;
      if (const auto written = writer_.object(0, id.digest, bytes); !written) return written;
    }
    return {};
  }

  /// The range in microseconds since the start of this recording.
  Result<void> copy(recording::Reader& reader, TimeUs from_us, TimeUs until_us) {
    if (const auto sought = reader.seek(from_us); !sought) return sought;
    std::optional<TimeUs> first_us;
    std::optional<Record> announce;  // Until a checkpoint follows, which makes the poses behind it readable.
    Bytes memory;
    for (;;) {
      auto record = reader.next();
      if (!record) return record.error();
      if (!*record || (**record).time_us > until_us) break;
      const TimeUs time_us = (**record).time_us;
      const Bytes& body = (**record).body;
      const auto at_us = [&] { return begun_us_ + std::max<TimeUs>(0, time_us - first_us.value_or(time_us)); };
      Result<void> written;
      switch ((**record).type) {
        case Type::kAnnounce:
          announce = std::move(**record);
          memory.clear();
          break;
        case Type::kMemory:
          memory = body;
          break;
        case Type::kCheckpoint:
          if (!first_us) first_us = time_us;
          if (announce) {
            add_missing(text_of(announce->body));
            written = writer_.announce(at_us(), text_of(announce->body), memory);
          }
          announce.reset();
          if (written) written = writer_.checkpoint(at_us(), body);
          break;
        case Type::kFrame:
          if (first_us && !announce) written = writer_.frame(at_us(), body);
          break;
        case Type::kGap:
          if (first_us && !announce) written = writer_.gap(at_us(), ByteReader(body).u64());
          break;
        default:
          break;
      }
      if (!written) return written;
    }
    if (first_us) begun_us_ = writer_.duration_us() + kBetweenFilesUs;
    return {};
  }

  /// Errors: kInvalidArgument: there is no pose.
  Result<CutFacts> finish() {
    if (begun_us_ == 0) return fail(ErrorCode::kInvalidArgument, "the range holds no pose");
    const CutFacts facts{writer_.duration_us(), writer_.frames(), 0};
    if (const auto finished = writer_.finish(); !finished) return finished.error();
    return CutFacts{facts.duration_us, facts.frames, writer_.bytes()};
  }

 private:
  /// As far as it is there: who reads the result sees what it holds.
  void add_missing(std::string_view text) {
    const auto message = control_from_text(text);
    const auto* announce = message ? std::get_if<control::Announce>(&*message) : nullptr;
    const auto id = announce != nullptr ? Sha256::from_hex(announce->asset) : std::nullopt;
    if (!missing_ || !id || copied_.contains(*id)) return;
    const auto whole = assemble_asset(*id, missing_);
    if (!whole) return;
    for (const auto* parts : {&whole->encoded.chunks, &whole->encoded.sections}) {
      for (const AssetObject& part : *parts) add(part);
    }
    add(whole->encoded.manifest);
  }
  void add(const AssetObject& object) {
    if (copied_.insert(object.id).second) (void)writer_.object(writer_.duration_us(), object.id.digest, object.bytes);
  }

  recording::Writer writer_;
  const std::function<Result<Bytes>(const Sha256&)>& missing_;
  std::set<Sha256> copied_;
  TimeUs begun_us_ = 0;  ///< Where the next recording begins.
};

}  // namespace

Result<CutFacts> cut_recordings(const std::vector<std::string>& files, double from_s, double duration_s,
                                const std::string& to, const std::function<Result<Bytes>(const Sha256&)>& missing) {
  std::error_code ignored;
  if (fs::exists(to, ignored)) return fail(ErrorCode::kRefused, to + ": is there already; name another file");
  std::vector<recording::Reader> readers;
  for (const std::string& file : files) {
    auto reader = recording::Reader::open(file);
    if (!reader) return reader.error();
    readers.push_back(*std::move(reader));
  }
  const std::string part = to + ".part";
  fs::remove(part, ignored);
  const auto made = [&]() -> Result<CutFacts> {
    auto writer = recording::Writer::create(part, readers.front().info().start);
    if (!writer) return writer.error();
    Cutter cutter(*std::move(writer), missing);
    for (std::size_t i = 0; i < readers.size(); ++i) {
      if (const auto copied = cutter.copy_objects(readers[i]); !copied) return in_context(files[i], copied.error());
    }
    // The range counts through all recordings.
    auto from_us = static_cast<TimeUs>(std::llround(from_s * 1e6));
    TimeUs left_us = duration_s > 0 ? static_cast<TimeUs>(std::llround(duration_s * 1e6)) : INT64_MAX / 4;
    for (std::size_t i = 0; i < readers.size() && left_us > 0; ++i) {
      const TimeUs length_us = readers[i].info().duration_us;
      if (from_us > length_us) {
        from_us -= length_us;
        continue;
      }
      const TimeUs until_us = std::min(from_us + left_us, length_us);
      if (const auto copied = cutter.copy(readers[i], from_us, until_us); !copied)
        return in_context(files[i], copied.error());
      left_us -= until_us - from_us;
      from_us = 0;
    }
    return cutter.finish();
  }();
  std::error_code code;
  if (made) fs::rename(part, to, code);
  if (!made || code) fs::remove(part, ignored);
  if (code) return fail(ErrorCode::kIo, to + ": cannot be written: " + code.message());
  return made;
}

}  // namespace eigencast
