// Below the cache's directory: objects/HH/REST, where HHREST is the object's SHA-256 in hexadecimal, and
// records/bake-KEY, which is 32 bytes SHA-256 of what follows, then the record. Names that start with a dot are
// unfinished writes.
#include "sdk/asset_cache.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>

#include "common/core/files.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxRecordBytes = 1 << 20;
constexpr std::size_t kDigestBytes = 32;

fs::path object_path(const std::string& directory, const Sha256& id) {
  const std::string hex = id.hex();
  return fs::path(directory) / "objects" / hex.substr(0, 2) / hex.substr(2);
}

fs::path record_path(const std::string& directory, const Sha256& key) {
  return fs::path(directory) / "records" / ("bake-" + key.hex());
}

void remove_quietly(const fs::path& path) {
  std::error_code ignored;  // another process may have removed or replaced it
  fs::remove(path, ignored);
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
  const fs::path temporary =
      path.parent_path() / (".tmp-" + std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1)));
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

AssetCache::AssetCache(std::string directory) : directory_(std::move(directory)) {}

std::optional<Bytes> AssetCache::load(const Sha256& id) const {
  if (directory_.empty()) return std::nullopt;
  const fs::path path = object_path(directory_, id);
  auto bytes = read_bytes(path.string(), limits::kMaxAssetObjectBytes);
  if (bytes && sha256(*bytes) == id) return std::move(*bytes);
  remove_quietly(path);
  return std::nullopt;
}

Result<void> AssetCache::store(const Sha256& id, ByteView bytes) const {
  if (directory_.empty()) return {};
  return write_atomically(object_path(directory_, id), {}, bytes);
}

std::optional<Bytes> AssetCache::load_record(const Sha256& key) const {
  if (directory_.empty()) return std::nullopt;
  const fs::path path = record_path(directory_, key);
  const auto bytes = read_bytes(path.string(), kMaxRecordBytes + kDigestBytes);
  if (bytes && bytes->size() >= kDigestBytes) {
    const ByteView body = ByteView(*bytes).subspan(kDigestBytes);
    if (std::equal(bytes->begin(), bytes->begin() + kDigestBytes, sha256(body).digest.begin())) {
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
  if (directory_.empty()) return {};
  return write_atomically(record_path(directory_, key), sha256(bytes).digest, bytes);
}

}  // namespace eigencast
