// SPDX-License-Identifier: MIT
#include "broker/storage/asset_store.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <random>
#include <system_error>
#include <unordered_set>
#include <utility>

#include "broker/relay/stream.h"
#include "common/asset/asset_limits.h"
#include "common/asset/format/manifest.h"

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;

Error io_error(const std::string& what, int number) {
  std::string message = what + ": " + std::generic_category().message(number);
  if (number == ENOSPC || number == EDQUOT || number == EFBIG)
    message += ": free some space in the broker's data folder";
  return fail(ErrorCode::kIo, std::move(message));
}

/// Period of updates of a file's times, which keep its last use across restarts.
constexpr TimeUs kTouchUs = 60'000'000;
constexpr std::size_t kCheckedBytes = 64 * 1024;  // At a time.

Result<void> sync_folder(const std::string& path) {
  const FileHandle folder(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (folder.get() < 0 || ::fsync(folder.get()) != 0) return io_error("syncing the asset store", errno);
  return {};
}

/// Locks a data folder to this process. Who can open a file can hold its lock: it is private, and one that belongs
/// neither to this user nor to the folder's is removed.
Result<FileHandle> locked(const std::string& data_dir) {
  const std::string path = data_dir + "/broker.lock";
  struct stat folder = {}, status = {};
  const auto is_strange = [&] {
    return !S_ISREG(status.st_mode) || (status.st_uid != ::geteuid() && status.st_uid != folder.st_uid);
  };
  if (::stat(data_dir.c_str(), &folder) == 0 && ::lstat(path.c_str(), &status) == 0 && is_strange()) {
    ::unlink(path.c_str());
  }
  FileHandle lock(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0600));
  if (lock.get() < 0 || ::fstat(lock.get(), &status) != 0) return io_error(path, errno);
  if (is_strange()) return fail(ErrorCode::kIo, path + " is not this broker's: remove it");
  (void)::fchmod(lock.get(), 0600);  // Earlier versions made it 0644.
  if (::flock(lock.get(), LOCK_EX | LOCK_NB) != 0) {
    return fail(ErrorCode::kRefused, data_dir + " is in use by another broker: stop it, or choose another --data-dir");
  }
  return lock;
}

}  // namespace

Result<std::unique_ptr<AssetStore>> AssetStore::open(const std::string& data_dir, const Settings& settings) {
  std::unique_ptr<AssetStore> store(new AssetStore(data_dir, settings));
  if (auto ready = store->make_writable(); !ready && ready.error().code == ErrorCode::kRefused) return ready.error();
  store->load();
  return store;
}

AssetStore::AssetStore(const std::string& data_dir, const Settings& settings)
    : data_dir_(data_dir), root_(data_dir + "/assets"), settings_(settings) {}

Result<void> AssetStore::make_writable() {
  const std::lock_guard one_at_a_time(locking_);
  if (lock_.get() >= 0) return {};
  std::error_code error;
  fs::create_directories(data_dir_, error);
  auto lock = locked(data_dir_);
  if (!lock) return lock.error();
  if (fs::is_symlink(root_ + "/uploading", error)) fs::remove(root_ + "/uploading", error);  // It is emptied.
  fs::create_directories(root_ + "/uploading", error);  // A full disk makes no new one.
  for (fs::directory_iterator it(root_ + "/uploading", error), end; !error && it != end; it.increment(error)) {
    std::error_code ignored;
    fs::remove_all(it->path(), ignored);
  }
  if (error) return fail(ErrorCode::kIo, root_ + ": " + error.message());
  lock_ = std::move(*lock);
  return {};
}

void AssetStore::load() {
  std::error_code error;
  const TimeUs now_us = steady_now_us();
  const auto wall =
      std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::system_clock::now().time_since_epoch());
  std::vector<std::pair<Entry, Sha256>> found;
  for (fs::recursive_directory_iterator it(root_, fs::directory_options::skip_permission_denied, error), end;
       !error && it != end; it.increment(error)) {
    const auto id = Sha256::from_hex(it->path().filename().string());
    struct stat status = {};
    if (!id || ::lstat(it->path().c_str(), &status) != 0 || !S_ISREG(status.st_mode)) continue;
    // A file from the future (after a clock step) counts as used now.
    const TimeUs used_us = now_us - std::max<TimeUs>(0, wall.count() - status.st_mtim.tv_sec * 1'000'000);
    const auto size = static_cast<std::uint64_t>(status.st_size);
    found.emplace_back(Entry{.size = size, .used_us = used_us, .touched_us = used_us, .content = Content::kUnread},
                       *id);
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.first.used_us < b.first.used_us; });
  const std::lock_guard lock(mutex_);
  for (auto& [entry, id] : found) {
    if (entries_.contains(id)) continue;
    entry.holder = &holder({});
    charge(*entry.holder, static_cast<std::int64_t>(charge_of(entry.size)), 1);
    insert(id, entry);
  }
}

AssetStore::Holder& AssetStore::holder(std::string_view name) {
  const auto found = holders_.find(name);
  if (found != holders_.end()) return found->second;
  return holders_.emplace(std::string(name), Holder{std::string(name)}).first->second;
}

double AssetStore::load(const std::string& name) const {
  const auto found = holders_.find(name);
  return found == holders_.end() ? 0 : found->second.load;
}

void AssetStore::charge(Holder& holder, std::int64_t bytes, int objects) {
  total_bytes_ += static_cast<std::uint64_t>(bytes);
  objects_ += static_cast<std::uint64_t>(objects);
  count(holder, bytes, objects);
}

void AssetStore::count(Holder& holder, std::int64_t bytes, int objects) {
  const auto part = [](std::uint64_t of, std::uint64_t all) {
    return static_cast<double>(of) / static_cast<double>(all);
  };
  by_load_.erase({holder.load, &holder});
  holder.bytes += static_cast<std::uint64_t>(bytes);
  holder.objects += static_cast<std::uint64_t>(objects);
  holder.load = std::max(part(holder.bytes, settings_.max_total_bytes), part(holder.objects, settings_.max_objects));
  if (holder.objects == 0) {
    holders_.erase(holders_.find(holder.name));
  } else {
    by_load_.emplace(holder.load, &holder);
  }
}

bool AssetStore::pass_on(Entry& entry) {
  if (entry.user.empty() || entry.user_us < noted_us_) return false;
  const auto bytes = static_cast<std::int64_t>(charge_of(entry.size));
  Holder& from = *entry.holder;
  Holder& to = holder(entry.user);
  count(to, bytes, 1);
  const bool fits = !to.is_over();
  if (fits) {
    entry.user.clear();
    entry.holder = &to;
    to.order.splice(to.order.end(), from.order, entry.held);
  }
  count(fits ? from : to, -bytes, -1);
  return fits;
}

void AssetStore::insert(const Sha256& id, Entry entry) {
  entry.order = order_.insert(order_.end(), id);
  entry.held = entry.holder->order.insert(entry.holder->order.end(), id);
  entries_.insert_or_assign(id, entry);
}

void AssetStore::erase(std::unordered_map<Sha256, Entry, IdHash>::iterator entry) {
  Holder& holder = *entry->second.holder;
  order_.erase(entry->second.order);
  holder.order.erase(entry->second.held);
  const std::uint64_t bytes = charge_of(entry->second.size);
  entries_.erase(entry);
  charge(holder, -static_cast<std::int64_t>(bytes), -1);
}

std::size_t AssetStore::IdHash::operator()(const Sha256& id) const {
  static const std::uint64_t key = (std::uint64_t{std::random_device{}()} << 32 | std::random_device{}()) | 1;
  std::uint64_t prefix = 0;
  std::memcpy(&prefix, id.digest.data(), sizeof prefix);
  return static_cast<std::size_t>(prefix * key >> 16);
}

void AssetStore::use(Entry& entry, TimeUs now_us) const {
  entry.used_us = now_us;
  order_.splice(order_.end(), order_, entry.order);
  entry.holder->order.splice(entry.holder->order.end(), entry.holder->order, entry.held);
}

std::string AssetStore::path_of(const Sha256& id) const {
  const std::string hex = id.hex();
  return root_ + "/" + hex.substr(0, 2) + "/" + hex;
}

bool AssetStore::contains(const Sha256& id) const {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found == entries_.end() || found->second.content == Content::kTorn) return false;
  use(found->second, steady_now_us());  // The caller is about to announce it.
  return true;
}

Result<AssetStore::Object> AssetStore::read(const Sha256& id) const {
  const TimeUs now_us = steady_now_us();
  bool touch = false, is_unread = false;
  {
    const std::lock_guard lock(mutex_);
    const auto found = entries_.find(id);
    if (found == entries_.end() || found->second.content == Content::kTorn)
      return fail(ErrorCode::kNotFound, "there is no asset " + id.hex());
    is_unread = found->second.content == Content::kUnread;
    use(found->second, now_us);
    touch = now_us - found->second.touched_us > kTouchUs;
    if (touch) found->second.touched_us = now_us;
  }
  FileHandle file(::open(path_of(id).c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
  if (file.get() < 0) {
    if (errno == ENOENT) return note_gone(id);
    return io_error("asset " + id.hex(), errno);
  }
  struct stat status = {};
  if (::fstat(file.get(), &status) != 0) return io_error("asset " + id.hex(), errno);
  if (touch) ::futimens(file.get(), nullptr);
  if (is_unread) {
    const auto whole = check(id, file.get());
    if (!whole) return whole.error();
    if (!*whole)
      return fail(ErrorCode::kNotFound, "asset " + id.hex() + " is damaged on the broker's disk: upload it again");
  }
  std::array<std::uint8_t, kSegmentMagic.size()> magic{};
  const bool is_segment =
      ::pread(file.get(), magic.data(), magic.size(), 0) == ssize_t{magic.size()} && magic == kSegmentMagic;
  return Object{std::move(file), static_cast<std::uint64_t>(status.st_size), is_segment};
}

/// Others removed its file: it is to be uploaded again.
Error AssetStore::note_gone(const Sha256& id) const {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found != entries_.end() && ::access(path_of(id).c_str(), F_OK) != 0) found->second.content = Content::kTorn;
  return fail(ErrorCode::kNotFound, "there is no asset " + id.hex());
}

Result<bool> AssetStore::check(const Sha256& id, int file) const {
  Sha256Stream hash;
  Bytes piece(kCheckedBytes);
  off_t at = 0;
  ssize_t got = 0;
  for (; (got = ::pread(file, piece.data(), piece.size(), at)) > 0; at += got)
    hash.update(ByteView(piece).first(static_cast<std::size_t>(got)));
  if (got < 0) return io_error("asset " + id.hex(), errno);
  const bool is_whole = hash.finish() == id;
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  // An upload may have replaced the file.
  if (found != entries_.end() && found->second.content == Content::kUnread)
    found->second.content = is_whole ? Content::kWhole : Content::kTorn;
  return is_whole;
}

void AssetStore::set_used(std::string_view stream, const std::optional<Sha256>& asset, std::string_view holder) {
  const std::lock_guard lock(mutex_);
  if (const auto found = used_by_stream_.find(stream); found != used_by_stream_.end()) {
    forget_segments(found->second.segments);
    used_by_stream_.erase(found);
  }
  if (!asset) return;
  used_by_stream_.insert_or_assign(std::string(stream), Used{*asset, std::string(holder)});
  if (const auto entry = entries_.find(*asset); entry != entries_.end()) entry->second.read_us = kNever;
}

void AssetStore::forget_segments(const std::vector<Sha256>& segments) {
  const TimeUs now_us = steady_now_us();
  for (const Sha256& id : segments) {
    SegmentUse& use = segment_uses_[id];
    if (--use.streams > 0) continue;
    use.since_us = now_us;
    if (!std::exchange(use.queued, true)) forgotten_.emplace_back(id, now_us + settings_.min_idle_us);
  }
}

void AssetStore::on_memory(const Stream& stream) {
  const std::lock_guard lock(mutex_);
  const auto found = used_by_stream_.find(stream.name());
  if (found == used_by_stream_.end()) return;
  std::vector<Sha256> segments;
  if (const Generation* memory = stream.memory().get()) {
    for (const auto& segment : memory->segments) segments.push_back(*Sha256::from_hex(segment.id));
  }
  for (const Sha256& id : segments) ++segment_uses_[id].streams;
  forget_segments(std::exchange(found->second.segments, std::move(segments)));
}

/// One at a time under the lock, for which the loop waits.
void AssetStore::remove_forgotten(TimeUs now_us) {
  while (true) {
    const std::string aside = temporary_path();
    {
      const std::lock_guard lock(mutex_);
      if (forgotten_.empty() || now_us <= forgotten_.front().second) return;
      const Sha256 id = forgotten_.front().first;
      forgotten_.pop_front();
      const auto use = segment_uses_.find(id);
      use->second.queued = false;
      if (use->second.streams > 0) continue;
      const TimeUs due_us = use->second.since_us + settings_.min_idle_us;
      if (now_us <= due_us) {
        use->second.queued = true;
        forgotten_.emplace_back(id, due_us);
        continue;
      }
      segment_uses_.erase(use);
      const auto entry = entries_.find(id);
      if (entry == entries_.end() || ::rename(path_of(id).c_str(), aside.c_str()) != 0) continue;
      erase(entry);
    }
    ::unlink(aside.c_str());
  }
}

void AssetStore::on_announced(const Stream& stream) {
  set_used(stream.name(), Sha256::from_hex(stream.asset()), stream.payer());
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
  std::array<std::uint8_t, kManifestMagic.size()> magic{};
  const bool is_read = ::pread(object->file.get(), magic.data(), magic.size(), 0) == ssize_t{magic.size()};
  if (!is_read || magic != kManifestMagic || object->size > asset_limits::kMaxManifestBytes) return found;
  const auto content = bytes_of(id);
  if (!content) return content.error();
  std::unordered_set<Sha256, IdHash> seen;
  for (const Sha256& part : objects_of_manifest(*content)) {
    const std::lock_guard lock(mutex_);
    const auto entry = entries_.find(part);
    if (entry == entries_.end() || !seen.insert(part).second) continue;
    use(entry->second, steady_now_us());
    found.push_back(part);
  }
  return found;
}

bool AssetStore::is_over() const {
  return total_bytes_ > settings_.max_total_bytes || objects_ > settings_.max_objects;
}

void AssetStore::note_uses() {
  const TimeUs now_us = steady_now_us(), period_us = settings_.min_idle_us / 3;
  std::map<Sha256, Users> due;
  std::string at;  // No stream's name is empty.
  while (true) {   // One stream at a time under the lock, for which the loop waits.
    const std::lock_guard lock(mutex_);
    const auto next = used_by_stream_.upper_bound(at);
    if (next == used_by_stream_.end()) break;
    const auto& [stream, used] = *next;
    at = stream;
    auto known = due.find(used.asset);  // Several streams may use it.
    if (known == due.end()) {
      const auto entry = entries_.find(used.asset);
      if (entry == entries_.end() || now_us - entry->second.read_us < period_us) continue;
      entry->second.read_us = now_us;
      known = due.try_emplace(used.asset).first;
    }
    for (const Sha256& id : used.segments) {
      if (const auto segment = entries_.find(id); segment != entries_.end()) use(segment->second, now_us);
    }
    Users& users = known->second;
    if (!used.holder.empty()) users.emplace(load(used.holder), used.holder);
    if (users.size() > 2) users.erase(std::prev(users.end()));  // One may be the holder itself.
  }
  for (const auto& [asset, users] : due) {
    auto used = references_of(asset);
    if (!used || users.empty()) continue;
    used->push_back(asset);
    for (const Sha256& id : *used) note_users(id, users, now_us);
  }
  noted_us_ = now_us - period_us;
  remove_forgotten(now_us);
  if (!fails_) return;
  const std::string probe = temporary_path();
  if (make_file(probe).get() >= 0) ::unlink(probe.c_str());
}

void AssetStore::note_users(const Sha256& id, const Users& users, TimeUs now_us) {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found == entries_.end()) return;
  Entry& entry = found->second;
  const auto user =
      std::find_if(users.begin(), users.end(), [&](const auto& one) { return one.second != entry.holder->name; });
  if (user == users.end()) return;
  const bool known = !entry.user.empty() && entry.user_us >= noted_us_;
  if (!known || load(entry.user) > user->first) entry.user = user->second;
  if (entry.user == user->second) entry.user_us = now_us;
  if (entry.holder->is_over()) (void)pass_on(entry);
}

bool AssetStore::evict_oldest(const Holder& wanting) {
  const TimeUs now_us = steady_now_us();
  const std::string aside = temporary_path();
  {
    const std::lock_guard lock(mutex_);
    if (!is_over()) return false;
    const auto most = std::find_if(by_load_.rbegin(), by_load_.rend(),
                                   [](const auto& holder) { return !holder.second->order.empty(); });
    const bool own = most == by_load_.rend() || wanting.load >= most->first;
    const Holder& giver = own ? wanting : *most->second;
    bool gives = giver.is_over();
    const auto& order = gives ? giver.order : order_;
    if (order.empty()) return false;
    auto entry = entries_.find(order.front());
    const TimeUs used_us = entry->second.used_us, idle_since_us = now_us - settings_.min_idle_us;
    if (!gives && !own && used_us >= idle_since_us) gives = true, entry = entries_.find(giver.order.front());
    if (gives && pass_on(entry->second)) return true;
    if (used_us >= std::min(idle_since_us, noted_us_.load()) && (own || !gives)) return false;
    // Freeing a large file takes long and contains() waits for the lock: unlink after it.
    if (::rename(path_of(entry->first).c_str(), aside.c_str()) != 0 && errno != ENOENT) {
      use(entry->second, now_us);  // The next one first.
      return own || !gives;
    }
    erase(entry);
    ++evicted_;
  }
  ::unlink(aside.c_str());  // Downloads in progress end with a reset: each piece opens its asset.
  return true;
}

Result<bool> AssetStore::admit(const Sha256& id, const std::string& verified, std::uint64_t size, Holder& holder) {
  const TimeUs now_us = steady_now_us();
  const std::string path = path_of(id);
  const std::lock_guard lock(mutex_);
  const auto known = entries_.find(id);
  if (known != entries_.end() && known->second.content != Content::kTorn && ::access(path.c_str(), F_OK) == 0) {
    use(known->second, now_us);
    return false;
  }
  if (::rename(verified.c_str(), path.c_str()) != 0) return io_error("keeping asset " + id.hex(), errno);
  if (known != entries_.end()) erase(known);  // Its file was torn, or removed by others.
  insert(id, {.size = size, .used_us = now_us, .touched_us = now_us, .holder = &holder, .is_durable = false});
  return true;
}

bool AssetStore::is_durable(const Sha256& id) {
  const std::lock_guard lock(mutex_);
  const auto known = entries_.find(id);
  if (known == entries_.end() || !known->second.is_durable || ::access(path_of(id).c_str(), F_OK) != 0) return false;
  use(known->second, steady_now_us());
  return true;
}

void AssetStore::note_durable(const Sha256& id) {
  const std::lock_guard lock(mutex_);
  if (const auto known = entries_.find(id); known != entries_.end()) known->second.is_durable = true;
}

std::string AssetStore::temporary_path() {
  return root_ + "/uploading/" + std::to_string(++temporaries_);
}

FileHandle AssetStore::make_file(const std::string& path) {
  const auto make = [&] { return FileHandle(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644)); };
  FileHandle file = make();
  std::error_code ignored;
  if (file.get() < 0 && errno == ENOENT && fs::create_directories(root_ + "/uploading", ignored)) file = make();
  fails_ = file.get() < 0 && errno != EMFILE && errno != ENFILE;
  return file;
}

Result<std::unique_ptr<AssetStore::Upload>> AssetStore::begin_upload(const Sha256& id, std::string_view holder) {
  if (!make_writable()) {
    return fail(ErrorCode::kIo, "the broker's data folder takes no files: its operator finds the reason in its log");
  }
  std::unique_ptr<Upload> upload(new Upload(*this, id, holder));
  if (auto room = upload->grow(0); !room) return room.error();
  upload->path_ = temporary_path();
  upload->file_ = make_file(upload->path_);
  if (upload->file_.get() < 0) return io_error("writing asset " + id.hex(), errno);
  return upload;
}

AssetStore::Upload::Upload(AssetStore& store, const Sha256& expected, std::string_view holder)
    : store_(store), expected_(expected) {
  const std::lock_guard lock(store_.mutex_);
  holder_ = &store_.holder(holder);
  store_.charge(*holder_, 0, 1);
}

AssetStore::Upload::~Upload() {
  if (kept_) return;
  ::unlink(path_.c_str());
  const std::lock_guard lock(store_.mutex_);
  store_.charge(*holder_, -static_cast<std::int64_t>(charge_), -1);
}

Result<void> AssetStore::Upload::grow(std::uint64_t bytes) {
  size_ += bytes;
  {
    const std::lock_guard lock(store_.mutex_);
    store_.charge(*holder_, static_cast<std::int64_t>(charge_of(size_) - charge_), 0);
  }
  charge_ = charge_of(size_);
  while (store_.is_over() && store_.evict_oldest(*holder_)) continue;
  if (!store_.is_over()) return {};
  return fail(ErrorCode::kIo,
              "the asset store is full of what streams use or used a moment ago, or of what others may "
              "keep: assets.max_total_bytes = " +
                  std::to_string(store_.settings_.max_total_bytes) +
                  ", assets.max_objects = " + std::to_string(store_.settings_.max_objects));
}

Result<void> AssetStore::Upload::write(ByteView data) {
  if (size_ + data.size() > store_.settings_.max_object_bytes) {
    return fail(ErrorCode::kTooLarge, "the object is over " + std::to_string(store_.settings_.max_object_bytes) +
                                          " bytes, the most that assets.max_object_bytes allows");
  }
  if (auto room = grow(data.size()); !room) return room;
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
  if (store_.is_durable(expected_) && store_.read(expected_)) return false;
  const std::string path = store_.path_of(expected_);
  const std::string folder = path.substr(0, path.rfind('/'));
  if (::mkdir(folder.c_str(), 0755) == 0) {
    if (auto synced = sync_folder(store_.root_); !synced) return synced.error();
  } else if (errno != EEXIST) {
    return io_error("keeping asset " + expected_.hex(), errno);
  }
  if (::fsync(file_.get()) != 0) return io_error("syncing asset " + expected_.hex(), errno);
  const auto admitted = store_.admit(expected_, path_, size_, *holder_);
  kept_ = admitted && *admitted;
  if (!admitted) return admitted;
  // Also if it existed: the other upload may not have synced yet.
  if (auto synced = sync_folder(folder); !synced) return synced.error();
  store_.note_durable(expected_);
  return admitted;
}

}  // namespace eigencast::broker
