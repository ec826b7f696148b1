// Below the cache's directory: objects/HH/REST, where HHREST is the object's SHA-256 in hexadecimal, and
// records/bake-KEY, which is 32 bytes SHA-256 of what follows, then the record. Names that start with a dot are
// unfinished writes.
#include "sdk/asset_cache.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <filesystem>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "common/core/files.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxRecordBytes = 1 << 20;
constexpr std::size_t kDigestBytes = 32;
constexpr std::uint64_t kDefaultBytes = std::uint64_t{4} << 30;
constexpr std::string_view kTemporary = ".tmp-", kBake = "bake-";
constexpr std::uint64_t kSlack = 64;  ///< The folder is looked through when 1/kSlack of the limit is written.

fs::path object_path(const std::string& directory, const Sha256& id) {
  const std::string hex = id.hex();
  return fs::path(directory) / "objects" / hex.substr(0, 2) / hex.substr(2);
}

fs::path record_path(const std::string& directory, const Sha256& key) {
  return fs::path(directory) / "records" / (std::string(kBake) + key.hex());
}

void remove_quietly(const fs::path& path) {
  std::error_code ignored;  // another process may have removed or replaced it
  fs::remove(path, ignored);
}

/// Blocks of the disk, and a share for name and inode.
std::uint64_t cost_of(std::uint64_t bytes) {
  return (bytes + 4095) / 4096 * 4096 + 512;
}

/// Whether the cache made it: the user may have named a folder that holds other things, too.
bool is_own(const fs::path& path) {
  const std::string name = path.filename().string();
  return name.starts_with(kTemporary) || Sha256::from_hex(path.parent_path().filename().string() + name) ||
         (name.starts_with(kBake) && Sha256::from_hex(name.substr(kBake.size())));
}

void note_use(const fs::path& path) {
  std::error_code ignored;  // a read-only folder keeps what it has
  fs::last_write_time(path, fs::file_time_type::clock::now(), ignored);
}

Error io_error(const fs::path& path, const char* what, int error) {
  return fail(ErrorCode::kIo, path.string() + ": " + what + ": " + std::generic_category().message(error) +
                                  "; free some space or name another cache directory");
}

bool write_all(int fd, ByteView bytes) {
  while (!bytes.empty()) {
    const ssize_t wrote = ::write(fd, bytes.data(), bytes.size());
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote < 0) return false;
    bytes = bytes.subspan(static_cast<std::size_t>(wrote));
  }
  return true;
}

/// Through a temporary name. No fsync: what a power cut tears fails its hash and is removed.
Result<void> write_atomically(const fs::path& path, ByteView head, ByteView body) {
  static std::atomic<unsigned> counter{0};
  std::error_code error;
  fs::create_directories(path.parent_path(), error);
  if (error) return io_error(path.parent_path(), "cannot make the folder", error.value());
  const fs::path temporary = path.parent_path() / (std::string(kTemporary) + std::to_string(::getpid()) + "-" +
                                                   std::to_string(counter.fetch_add(1)));
  {
    const FileHandle file(::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644));
    if (file.get() < 0) return io_error(temporary, "cannot create", errno);
    if (!write_all(file.get(), head) || !write_all(file.get(), body)) {
      const Error failed = io_error(temporary, "cannot write", errno);
      remove_quietly(temporary);
      return failed;
    }
  }
  fs::rename(temporary, path, error);
  if (!error) return {};
  remove_quietly(temporary);
  return io_error(path, "cannot rename to", error.value());
}

}  // namespace

std::string default_cache_dir() {
  const auto variable = [](const char* name) -> std::string {
    const char* value = std::getenv(name);
    return value != nullptr ? value : "";
  };
  if (std::string own = variable("EIGENCAST_CACHE"); !own.empty()) return own;
  // The XDG specification has relative paths ignored.
  if (const std::string xdg = variable("XDG_CACHE_HOME"); !xdg.empty() && xdg.front() == '/') return xdg + "/eigencast";
  if (const std::string home = variable("HOME"); !home.empty()) return home + "/.cache/eigencast";
  return {};
}

std::uint64_t default_cache_bytes() {
  const char* value = std::getenv("EIGENCAST_CACHE_BYTES");
  const std::string_view text = value != nullptr ? value : "";
  std::uint64_t bytes = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), bytes);
  return text.empty() || error != std::errc() || end != text.data() + text.size() ? kDefaultBytes : bytes;
}

AssetCache::AssetCache(std::string directory, std::uint64_t max_bytes)
    : directory_(std::move(directory)), max_bytes_(max_bytes), unchecked_(max_bytes) {}

void AssetCache::make_room(std::uint64_t written) const {
  if (unchecked_.fetch_add(written) + written <= max_bytes_ / kSlack) return;
  unchecked_ = 0;
  struct File {
    fs::file_time_type used;
    std::uint64_t cost;
    fs::path path;
  };
  std::vector<File> files;
  std::uint64_t total = 0;
  for (const char* part : {"objects", "records"}) {
    std::error_code error;
    for (fs::recursive_directory_iterator it(fs::path(directory_) / part, error), end; !error && it != end;
         it.increment(error)) {
      std::error_code gone;
      if (!fs::is_regular_file(it->symlink_status(gone)) || !is_own(it->path())) continue;
      const std::uint64_t cost = cost_of(it->file_size(gone));
      const auto used = it->last_write_time(gone);
      if (gone) continue;
      total += cost;
      files.push_back({used, cost, it->path()});
    }
  }
  std::sort(files.begin(), files.end(), [](const File& a, const File& b) { return a.used < b.used; });
  for (const File& file : files) {
    if (total <= max_bytes_ - max_bytes_ / kSlack) return;
    remove_quietly(file.path);
    total -= file.cost;
  }
}

std::optional<Bytes> AssetCache::load(const Sha256& id) const {
  if (directory_.empty()) return std::nullopt;
  const fs::path path = object_path(directory_, id);
  auto bytes = read_bytes(path.string(), limits::kMaxAssetObjectBytes);
  if (bytes && sha256(*bytes) == id) {
    note_use(path);
    return std::move(*bytes);
  }
  remove_quietly(path);
  return std::nullopt;
}

Result<void> AssetCache::store(const Sha256& id, ByteView bytes) const {
  if (directory_.empty() || cost_of(bytes.size()) > max_bytes_) return {};
  auto stored = write_atomically(object_path(directory_, id), {}, bytes);
  make_room(cost_of(bytes.size()));
  return stored;
}

std::optional<Bytes> AssetCache::load_record(const Sha256& key) const {
  if (directory_.empty()) return std::nullopt;
  const fs::path path = record_path(directory_, key);
  const auto bytes = read_bytes(path.string(), kMaxRecordBytes + kDigestBytes);
  if (bytes && bytes->size() >= kDigestBytes) {
    const ByteView body = ByteView(*bytes).subspan(kDigestBytes);
    if (std::equal(bytes->begin(), bytes->begin() + kDigestBytes, sha256(body).digest.begin())) {
      note_use(path);
      return Bytes(body.begin(), body.end());
    }
  }
  remove_quietly(path);
  return std::nullopt;
}

Result<void> AssetCache::store_record(const Sha256& key, ByteView bytes) const {
  if (bytes.size() > kMaxRecordBytes) {
    return fail(ErrorCode::kTooLarge,
                "a record of " + std::to_string(bytes.size()) + " bytes: at most " + std::to_string(kMaxRecordBytes));
  }
  if (directory_.empty() || cost_of(bytes.size() + kDigestBytes) > max_bytes_) return {};
  auto stored = write_atomically(record_path(directory_, key), sha256(bytes).digest, bytes);
  make_room(cost_of(bytes.size() + kDigestBytes));
  return stored;
}

}  // namespace eigencast
