// SPDX-License-Identifier: MIT
// The files that a recorder has and may have: those of earlier runs, those kept, quotas.
#include <algorithm>
#include <filesystem>
#include <functional>
#include <queue>
#include <system_error>
#include <tuple>
#include <utility>

#include "broker/storage/recorder_parts.h"
#include "common/core/share.h"
#include "common/recording/reader.h"

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMorePieces = 256;  ///< Of one stream: each announcement begins a file, and all are looked at.
constexpr std::size_t kShortenedAtOnce = 256;

/// The hash in the name of a file that is kept, or empty.
std::string holder_of_file(const std::string& path) {
  const std::string stem = fs::path(path).stem().string();
  const std::string text = stem.substr(stem.rfind('.') + 1, kHolderDigits);
  return text.find_first_not_of("0123456789abcdef") == std::string::npos ? text : std::string();
}

}  // namespace

void Recorder::repair() {
  std::error_code error;
  fs::create_directories(settings_.folder, error);
  for (fs::directory_iterator it(settings_.folder, error), end; !error && it != end; it.increment(error)) {
    const std::string path = it->path().string();
    if (!path.ends_with(kRecordingSuffix)) continue;
    const auto recovered = recording::recover(path);
    if (!recovered) {
      log(log_, LogLevel::kWarning, "a recording cannot be repaired: " + recovered.error().message);
      std::error_code ignored;
      if (settings_.keep_us > 0) fs::remove(path, ignored);
    } else if (!recovered->was_complete) {
      log(log_, LogLevel::kWarning,
          path + ": was cut off; repaired with " + std::to_string(recovered->frames) + " frames, " +
              std::to_string(recovered->cut_bytes) + " bytes of a torn one removed");
    }
    if (recovered && settings_.keep_us > 0) restore(path);
  }
  recount();
}

/// One that an earlier run kept; one of no use is removed.
void Recorder::restore(const std::string& path) {
  auto reader = recording::Reader::open(path);
  const auto announce = [&]() -> std::optional<control::Announce> {
    if (!reader || reader->index().empty() || !reader->seek(reader->index().front().time_us)) return std::nullopt;
    const auto record = reader->next();
    if (!record || !*record) return std::nullopt;
    const Bytes& body = (**record).body;
    const auto message = control_from_text({reinterpret_cast<const char*>(body.data()), body.size()});
    const auto* announced = message ? std::get_if<control::Announce>(&*message) : nullptr;
    return announced != nullptr ? std::optional(*announced) : std::nullopt;
  }();
  const TimeUs from_us = reader ? static_cast<TimeUs>(reader->info().start.started_unix_us) : 0;
  if (!announce) {
    std::error_code ignored;
    fs::remove(path, ignored);
    return;
  }
  auto kept = std::make_shared<Kept>();
  kept->file = path;
  kept->from_us = from_us;
  kept->to_us = from_us + reader->info().duration_us;
  kept->asset = announce->asset;
  kept->charged = file_cost(reader->info().whole_bytes);
  kept->holder = holder_of_file(path);
  if (!kept->holder.empty()) holder_of_[path] = kept->holder;
  pin(kept->asset, 1);
  if (from_us > unix_from_steady(steady_now_us()) + kPieceUs) return ahead_.push_back(std::move(kept));
  const std::lock_guard lock(kept_mutex_);
  auto& all = kept_[reader->info().start.stream];
  all.insert(std::upper_bound(all.begin(), all.end(), from_us,
                              [](TimeUs at_us, const KeptPtr& one) { return at_us < one->from_us; }),
             kept);
}

/// The file of a session joins those kept.
void Recorder::keep(Session& session, const Item& announced, const std::string& path) {
  auto kept = std::make_shared<Kept>();
  kept->file = path;
  kept->asset = announced.begins->announced.asset;
  kept->holder = session.holder;
  kept->growing = true;
  kept->from_us = kept->to_us = session.start_unix_us;
  pin(kept->asset, 1, announced.begins->holder);
  const bool follows = [&] {
    const std::lock_guard lock(mutex_);
    return session.follows;
  }();
  const std::lock_guard lock(kept_mutex_);
  auto& all = kept_[session.stream];
  if (follows && !all.empty()) {
    all.back()->to_us = kept->from_us;
    all.back()->growing = false;
  }
  all.push_back(kept);
  session.kept = kept;
}

/// So many more of the files that are kept need an asset.
void Recorder::pin(const std::string& asset, int files, const std::string& holder) {
  const int before = pins_[asset], after = pins_[asset] += files;
  if (after == 0) pins_.erase(asset);
  if ((before == 0) == (after == 0)) return;
  const std::string user = "~history/" + asset;  // No stream's name.
  assets_.set_used(user, after == 0 ? std::nullopt : Sha256::from_hex(asset), holder);
}

/// Whether it got through by then.
bool Recorder::remove_oldest(TimeUs until_us) {
  if (settings_.keep_us == 0) return true;
  for (; !ahead_.empty() && totals().stored_bytes >= settings_.max_total_bytes; ahead_.pop_back())
    remove(*ahead_.back());
  do {
    const auto streams = streams_to_shorten(unix_from_steady(steady_now_us()));
    if (streams.empty()) return true;
    for (const std::string& stream : streams) {
      KeptPtr gone;
      {
        const std::lock_guard lock(kept_mutex_);
        const auto from = kept_.find(stream);
        gone = std::move(from->second.front());
        from->second.pop_front();
        if (from->second.empty()) kept_.erase(from);
      }
      remove(*gone);
    }
  } while (steady_now_us() < until_us);
  return false;
}

void Recorder::remove(const Kept& gone) {
  {
    const std::lock_guard lock(mutex_);
    totals_.stored_bytes -= std::min(totals_.stored_bytes, gone.charged);
    std::uint64_t& held = holders_[gone.holder];
    held -= std::min(held, gone.charged);
    if (held == 0) holders_.erase(gone.holder);
  }
  holder_of_.erase(gone.file);
  pin(gone.asset, -1);
  std::error_code ignored;
  fs::remove(gone.file, ignored);
}

/// Those whose first file is over: by its age, or of a stream with too many; then the oldest of the holder of most, of
/// those beyond their share of bytes or names or, where there is too much, of all. Each stream once: what is left is
/// for the next time.
std::vector<std::string> Recorder::streams_to_shorten(TimeUs now_us) const {
  struct First {
    TimeUs from_us = 0;
    const std::string* stream = nullptr;
    std::int64_t charged = 0;
    bool only = false;
    bool operator>(const First& other) const { return from_us > other.from_us; }
  };
  struct Holder {
    std::int64_t bytes = 0, names = 0;
    bool has_more = false;  ///< Behind those below.
    std::priority_queue<First, std::vector<First>, std::greater<>> oldest;
  };
  std::map<std::string, Holder> holders;
  const auto max = static_cast<std::int64_t>(settings_.max_total_bytes);
  std::int64_t stored = 0;
  {
    const std::lock_guard lock(mutex_);
    stored = static_cast<std::int64_t>(totals_.stored_bytes);
    for (const auto& [name, bytes] : holders_) holders[name].bytes = static_cast<std::int64_t>(bytes);
  }
  const auto most_files = static_cast<std::size_t>(settings_.keep_us / kPieceUs) + kMorePieces;
  std::vector<std::string> gone;
  const std::lock_guard lock(kept_mutex_);
  auto names = std::ssize(kept_);
  for (const auto& [stream, files] : kept_) {
    const Kept& first = *files.front();
    Holder& holder = holders[first.holder];
    ++holder.names;
    if (first.growing) continue;
    if (first.to_us < now_us - settings_.keep_us || files.size() > most_files) {
      gone.push_back(stream);
    } else {
      holder.oldest.push({first.from_us, &stream, static_cast<std::int64_t>(first.charged), files.size() == 1});
    }
  }
  const auto is_over = [&](const std::string& name, const Holder& holder) {
    if (holder.oldest.empty() && !holder.has_more) return false;
    if (stored >= max || names > settings_.max_kept_streams) return true;
    return !name.empty() && (holder.bytes >= share_of(max, stored, holder.bytes) ||
                             holder.names > share_of(settings_.max_kept_streams, names, holder.names));
  };
  while (gone.empty() || gone.size() < kShortenedAtOnce) {
    Holder* most = nullptr;
    for (auto& [name, holder] : holders) {
      if (!is_over(name, holder)) continue;
      const bool more = most == nullptr || std::tie(holder.bytes, holder.names) > std::tie(most->bytes, most->names);
      const bool as_much = !more && std::tie(holder.bytes, holder.names) == std::tie(most->bytes, most->names);
      const bool known = as_much && !most->oldest.empty() && !holder.oldest.empty();
      if (more || (known && most->oldest.top() > holder.oldest.top())) most = &holder;
    }
    if (most == nullptr || most->oldest.empty()) break;
    const First first = most->oldest.top();
    most->oldest.pop();
    gone.push_back(*first.stream);
    stored -= first.charged;
    most->bytes -= first.charged;
    most->has_more = most->has_more || !first.only;
    if (!first.only) continue;
    --names;
    --most->names;
  }
  return gone;
}

/// Finds what others removed.
void Recorder::recount() {
  std::map<std::string, std::string> still_there;
  std::map<std::string, std::uint64_t> holders;
  std::uint64_t stored = 0;
  std::error_code error;
  for (fs::directory_iterator it(settings_.folder, error), end; !error && it != end; it.increment(error)) {
    const std::string path = it->path().string();
    std::error_code gone;
    const std::uint64_t size = fs::file_size(path, gone);
    if (gone || !path.ends_with(kRecordingSuffix)) continue;
    stored += file_cost(size);
    if (const auto known = holder_of_.find(path); known != holder_of_.end()) {
      holders[known->second] += file_cost(size);
      still_there.insert(*known);
    }
  }
  if (error) return;
  holder_of_.swap(still_there);
  const std::lock_guard lock(mutex_);
  totals_.stored_bytes = stored;
  holders_.swap(holders);
}

/// The quota that leaves this holder nothing; null: there is room. REQUIRES: mutex_ is held.
const char* Recorder::used_up(const std::string& holder) const {
  const auto max = static_cast<std::int64_t>(settings_.max_total_bytes);
  const auto stored = static_cast<std::int64_t>(totals_.stored_bytes);
  const auto held = holders_.find(holder);
  const auto own = static_cast<std::int64_t>(held == holders_.end() ? 0 : held->second);
  if (stored >= max) return "the recordings take all that recording.max_total_bytes allows";
  if (own < share_of(max, stored, own)) return nullptr;
  return "those of its sender's token or address take a quarter of what others leave of recording.max_total_bytes";
}

}  // namespace eigencast::broker
