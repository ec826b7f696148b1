// SPDX-License-Identifier: MIT
#include "broker/storage/asset_store.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;

Error io_error(const std::string& what, int number) {
  std::string message = what + ": " + std::generic_category().message(number);
  if (number == ENOSPC || number == EDQUOT) message += ": free some space in the broker's data folder";
  return fail(ErrorCode::kIo, std::move(message));
}

Result<void> sync_folder(const std::string& path) {
  const FileHandle folder(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (folder.get() < 0 || ::fsync(folder.get()) != 0) return io_error(path, errno);
  return {};
}

}  // namespace

FileHandle::~FileHandle() {
  if (fd_ >= 0) ::close(fd_);
}

FileHandle& FileHandle::operator=(FileHandle&& other) noexcept {
  std::swap(fd_, other.fd_);
  return *this;
}

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

AssetStore::~AssetStore() = default;

Result<void> AssetStore::prepare() {
  std::error_code error;
  fs::remove_all(root_ + "/uploading", error);
  fs::create_directories(root_ + "/uploading", error);
  if (error) return fail(ErrorCode::kIo, root_ + ": " + error.message());
  std::uint64_t total = 0;
  for (fs::recursive_directory_iterator it(root_, error), end; !error && it != end; it.increment(error)) {
    if (it->is_regular_file(error)) total += it->file_size(error);
  }
  if (error) return fail(ErrorCode::kIo, root_ + ": " + error.message());
  total_bytes_ = total;
  return {};
}

std::string AssetStore::path_of(const Sha256& id) const {
  const std::string hex = id.hex();
  return root_ + "/" + hex.substr(0, 2) + "/" + hex;
}

bool AssetStore::contains(const Sha256& id) const {
  return ::access(path_of(id).c_str(), R_OK) == 0;
}

Result<AssetStore::Object> AssetStore::read(const Sha256& id) const {
  FileHandle file(::open(path_of(id).c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) {
    if (errno == ENOENT) return fail(ErrorCode::kNotFound, "there is no asset " + id.hex());
    return io_error("asset " + id.hex(), errno);
  }
  struct stat facts = {};
  if (::fstat(file.get(), &facts) != 0) return io_error("asset " + id.hex(), errno);
  return Object{std::move(file), static_cast<std::uint64_t>(facts.st_size)};
}

Result<std::unique_ptr<AssetStore::Upload>> AssetStore::begin_upload(const Sha256& id) {
  std::string path = root_ + "/uploading/" + std::to_string(++uploads_);
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
  if ((store_.total_bytes_ += data.size()) > store_.settings_.max_total_bytes) {
    return fail(ErrorCode::kIo, "the asset store is full: assets.max_total_bytes is " +
                                    std::to_string(store_.settings_.max_total_bytes));
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
  // link() fails where the object is there already, which rename() would not tell.
  if (::link(path_.c_str(), path.c_str()) != 0) {
    if (errno == EEXIST) return false;
    return io_error(path, errno);
  }
  kept_ = true;
  ::unlink(path_.c_str());
  if (auto synced = sync_folder(folder); !synced) return synced.error();
  return true;
}

}  // namespace eigencast::broker
