// SPDX-License-Identifier: MIT
#include "broker/storage/asset_store.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <unordered_map>
#include <utility>

#include "broker/relay/stream.h"

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;

Error io_error(const std::string& what, int number) {
  std::string message = what + ": " + std::generic_category().message(number);
  if (number == ENOSPC || number == EDQUOT || number == EFBIG)
    message += ": free some space in the broker's data folder";
  return fail(ErrorCode::kIo, std::move(message));
}

constexpr std::uint64_t kMaxListBytes = 32u << 20;  ///< Manifests are far smaller.
/// Period of updates of a file's times, which keep its last use across restarts.
constexpr TimeUs kTouchUs = 60'000'000;

Result<void> sync_folder(const std::string& path) {
  const FileHandle folder(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (folder.get() < 0 || ::fsync(folder.get()) != 0) return io_error(path, errno);
  return {};
}

}  // namespace

Result<std::unique_ptr<AssetStore>> AssetStore::open(const std::string& data_dir, const Settings& settings) {
  std::error_code error;
  fs::create_directories(data_dir, error);
  if (error) return fail(ErrorCode::kIo, data_dir + ": " + error.message() + ": choose another --data-dir");
  const std::string lock_path = data_dir + "/broker.lock";
  FileHandle lock(::open(lock_path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644));
  if (lock.get() < 0) return io_error(lock_path, errno);
  if (::flock(lock.get(), LOCK_EX | LOCK_NB) != 0) {
    return fail(ErrorCode::kRefused, data_dir + " is in use by another broker: stop it, or choose another --data-dir");
  }
  std::unique_ptr<AssetStore> store(new AssetStore(data_dir + "/assets", settings, std::move(lock)));
  if (auto prepared = store->prepare(); !prepared) return prepared.error();
  return store;
}

AssetStore::AssetStore(std::string root, const Settings& settings, FileHandle lock)
    : root_(std::move(root)), settings_(settings), lock_(std::move(lock)) {}

Result<void> AssetStore::prepare() {
  std::error_code error;
  fs::remove_all(root_ + "/uploading", error);
  fs::create_directories(root_ + "/uploading", error);
  if (error) return fail(ErrorCode::kIo, root_ + ": " + error.message());
  for (fs::directory_iterator it(root_, error), end; !error && it != end; it.increment(error)) {
    if (it->path().filename() != "uploading" && it->is_directory(error)) find_objects(it->path().string());
  }
  if (error) return fail(ErrorCode::kIo, root_ + ": " + error.message());
  for (const auto& [id, entry] : entries_) total_bytes_ += entry.size;
  return {};
}

void AssetStore::find_objects(const std::string& folder) {
  const TimeUs now_us = steady_now_us();
  const auto wall =
      std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::system_clock::now().time_since_epoch());
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    const auto id = Sha256::from_hex(it->path().filename().string());
    struct stat status = {};
    if (!id || ::stat(it->path().c_str(), &status) != 0 || !S_ISREG(status.st_mode)) continue;
    // A file from the future (after a clock step) counts as used now.
    const TimeUs age_us = std::max<TimeUs>(0, wall.count() - status.st_mtim.tv_sec * 1'000'000);
    entries_[*id] = {static_cast<std::uint64_t>(status.st_size), now_us - age_us, now_us - age_us};
  }
}

std::string AssetStore::path_of(const Sha256& id) const {
  const std::string hex = id.hex();
  return root_ + "/" + hex.substr(0, 2) + "/" + hex;
}

bool AssetStore::contains(const Sha256& id) const {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found == entries_.end()) return false;
  found->second.used_us = steady_now_us();  // The caller is about to announce it.
  return true;
}

std::size_t AssetStore::objects() const {
  const std::lock_guard lock(mutex_);
  return entries_.size();
}

Result<AssetStore::Object> AssetStore::read(const Sha256& id) const {
  const TimeUs now_us = steady_now_us();
  bool touch = false;
  {
    const std::lock_guard lock(mutex_);
    const auto found = entries_.find(id);
    if (found == entries_.end()) return fail(ErrorCode::kNotFound, "there is no asset " + id.hex());
    found->second.used_us = now_us;
    touch = now_us - found->second.touched_us > kTouchUs;
    if (touch) found->second.touched_us = now_us;
  }
  FileHandle file(::open(path_of(id).c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) {
    if (errno == ENOENT) return fail(ErrorCode::kNotFound, "there is no asset " + id.hex());
    return io_error("asset " + id.hex(), errno);
  }
  struct stat status = {};
  if (::fstat(file.get(), &status) != 0) return io_error("asset " + id.hex(), errno);
  if (touch) ::futimens(file.get(), nullptr);
  return Object{std::move(file), static_cast<std::uint64_t>(status.st_size)};
}

void AssetStore::set_used(std::string_view stream, const std::optional<Sha256>& asset) {
  const std::lock_guard lock(mutex_);
  if (asset) {
    used_by_stream_.insert_or_assign(std::string(stream), *asset);
  } else if (const auto found = used_by_stream_.find(stream); found != used_by_stream_.end()) {
    used_by_stream_.erase(found);
  }
}

void AssetStore::on_announced(const Stream& stream) {
  set_used(stream.name(), Sha256::from_hex(stream.asset()));
}

void AssetStore::on_forgotten(const Stream& stream) {
  set_used(stream.name(), std::nullopt);
}

Result<Bytes> AssetStore::bytes_of(const Sha256& id) const {
  const auto object = read(id);
  if (!object) return object.error();
  Bytes bytes(object->size);
  for (std::size_t at = 0; at < bytes.size();) {
    const ssize_t count = ::pread(object->file.get(), bytes.data() + at, bytes.size() - at, static_cast<off_t>(at));
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) return io_error("reading asset " + id.hex(), count == 0 ? EIO : errno);
    at += static_cast<std::size_t>(count);
  }
  return bytes;
}

Result<std::vector<Sha256>> AssetStore::references_of(const Sha256& id) const {
  std::vector<Sha256> found;
  const auto object = read(id);
  if (!object) return object.error();
  if (object->size < id.digest.size() || object->size > kMaxListBytes) return found;
  const auto content = bytes_of(id);
  if (!content) return content.error();
  const Bytes& bytes = *content;
  const auto prefix_of = [](const std::uint8_t* digest) {
    std::uint64_t prefix = 0;
    std::memcpy(&prefix, digest, sizeof prefix);
    return prefix;
  };
  std::unordered_multimap<std::uint64_t, Sha256> known;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [other, entry] : entries_) known.emplace(prefix_of(other.digest.data()), other);
  }
  for (std::size_t at = 0; at + id.digest.size() <= bytes.size(); ++at) {
    const auto [first, last] = known.equal_range(prefix_of(bytes.data() + at));
    for (auto it = first; it != last; ++it) {
      if (std::memcmp(it->second.digest.data(), bytes.data() + at, id.digest.size()) == 0) found.push_back(it->second);
    }
  }
  return found;
}

std::set<Sha256> AssetStore::needed() const {
  std::set<Sha256> all;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [stream, asset] : used_by_stream_) all.insert(asset);
  }
  for (const Sha256& asset : std::vector<Sha256>(all.begin(), all.end())) {
    const auto parts = references_of(asset);
    if (parts) all.insert(parts->begin(), parts->end());
  }
  return all;
}

void AssetStore::make_room() {
  const std::lock_guard one_at_a_time(evicting_);
  const std::set<Sha256> keep = needed();
  const TimeUs now_us = steady_now_us();
  std::vector<std::pair<TimeUs, Sha256>> idle;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, entry] : entries_) {
      if (!keep.contains(id) && now_us - entry.used_us >= settings_.min_idle_us) idle.emplace_back(entry.used_us, id);
    }
  }
  std::sort(idle.begin(), idle.end());
  for (const auto& [used_us, id] : idle) {
    if (total_bytes_ <= settings_.max_total_bytes) return;
    evict(id, used_us);
  }
}

void AssetStore::evict(const Sha256& id, TimeUs used_us) {
  const std::string aside = temporary_path();
  {
    const std::lock_guard lock(mutex_);
    const auto entry = entries_.find(id);
    if (entry == entries_.end() || entry->second.used_us != used_us) return;  // Used meanwhile.
    // Freeing a large file takes long and contains() waits for the lock: unlink after it.
    if (::rename(path_of(id).c_str(), aside.c_str()) != 0 && errno != ENOENT) return;
    total_bytes_ -= entry->second.size;
    entries_.erase(entry);
    ++evicted_;
  }
  ::unlink(aside.c_str());  // Downloads in progress keep their open file.
}

Result<bool> AssetStore::admit(const Sha256& id, const std::string& verified, std::uint64_t size) {
  const TimeUs now_us = steady_now_us();
  const std::string path = path_of(id);
  const std::lock_guard lock(mutex_);
  const auto known = entries_.find(id);
  if (known != entries_.end() && ::access(path.c_str(), F_OK) == 0) {
    known->second.used_us = now_us;
    return false;
  }
  if (::rename(verified.c_str(), path.c_str()) != 0) return io_error(path, errno);
  if (known != entries_.end()) total_bytes_ -= known->second.size;  // Its file was removed by others.
  entries_[id] = {size, now_us, now_us};
  return true;
}

std::string AssetStore::temporary_path() {
  return root_ + "/uploading/" + std::to_string(++temporaries_);
}

Result<std::unique_ptr<AssetStore::Upload>> AssetStore::begin_upload(const Sha256& id) {
  std::string path = temporary_path();
  FileHandle file(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644));
  if (file.get() < 0) return io_error(path, errno);
  return std::unique_ptr<Upload>(new Upload(*this, id, std::move(path), std::move(file)));
}

AssetStore::Upload::Upload(AssetStore& store, const Sha256& expected, std::string path, FileHandle file)
    : store_(store), expected_(expected), path_(std::move(path)), file_(std::move(file)) {}

AssetStore::Upload::~Upload() {
  if (kept_) return;
  ::unlink(path_.c_str());
  store_.total_bytes_ -= size_;
}

Result<void> AssetStore::Upload::write(ByteView data) {
  if (size_ + data.size() > store_.settings_.max_object_bytes) {
    return fail(ErrorCode::kTooLarge, "the object is over " + std::to_string(store_.settings_.max_object_bytes) +
                                          " bytes, the most that assets.max_object_bytes allows");
  }
  size_ += data.size();
  const std::uint64_t max = store_.settings_.max_total_bytes;
  if ((store_.total_bytes_ += data.size()) > max) store_.make_room();
  if (store_.total_bytes_ > max) {
    return fail(ErrorCode::kIo,
                "the asset store is full of what streams use or used a moment ago: "
                "assets.max_total_bytes is " +
                    std::to_string(max));
  }
  hash_.update(data);
  while (!data.empty()) {
    const ssize_t count = ::write(file_.get(), data.data(), data.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return io_error("writing asset " + expected_.hex(), errno);
    data = data.subspan(static_cast<std::size_t>(count));
  }
  return {};
}

Result<bool> AssetStore::Upload::commit() {
  const Sha256 actual = hash_.finish();
  if (actual != expected_) {
    return fail(ErrorCode::kCorrupt,
                "the body has SHA-256 " + actual.hex() + ", not " + expected_.hex() + ": nothing was kept");
  }
  const std::string path = store_.path_of(expected_);
  const std::string folder = path.substr(0, path.rfind('/'));
  if (::mkdir(folder.c_str(), 0755) == 0) {
    if (auto synced = sync_folder(store_.root_); !synced) return synced.error();
  } else if (errno != EEXIST) {
    return io_error(folder, errno);
  }
  if (::fsync(file_.get()) != 0) return io_error(path_, errno);
  const auto admitted = store_.admit(expected_, path_, size_);
  kept_ = admitted && *admitted;
  if (!admitted) return admitted;
  // Also if it existed: the other upload may not have synced yet.
  if (auto synced = sync_folder(folder); !synced) return synced.error();
  return admitted;
}

}  // namespace eigencast::broker
