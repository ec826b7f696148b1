// SPDX-License-Identifier: MIT
#include "broker/storage/asset_store.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/inotify.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>

#include "broker/relay/hub.h"
#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;

/// How often files are opened.
class OpenCount {
 public:
  void watch(const std::string& path) { EXPECT_GE(::inotify_add_watch(events_.get(), path.c_str(), IN_OPEN), 0); }
  ssize_t count() {
    inotify_event events[64];
    for (ssize_t bytes = 0; (bytes = ::read(events_.get(), events, sizeof(events))) > 0;) {
      opened_ += std::count_if(events, events + bytes / static_cast<ssize_t>(sizeof(inotify_event)),
                               [](const inotify_event& event) { return (event.mask & IN_OPEN) != 0; });
    }
    return opened_;
  }

 private:
  const FileHandle events_{::inotify_init1(IN_NONBLOCK)};
  ssize_t opened_ = 0;
};

class AssetStoreTest : public ::testing::Test {
 protected:
  AssetStoreTest() {
    std::string pattern = (fs::temp_directory_path() / "eigencast-store-XXXXXX").string();
    folder_ = ::mkdtemp(pattern.data());
  }
  ~AssetStoreTest() override {
    store_.reset();
    fs::remove_all(folder_);
  }
  void open(const AssetStore::Settings& settings = {}) {
    store_.reset();
    auto opened = AssetStore::open(folder_, settings);
    ASSERT_TRUE(opened) << opened.error().message;
    store_ = std::move(*opened);
  }
  /// The object's id; nothing if the store is full.
  std::optional<Sha256> put(const Bytes& content, const std::string& holder = {}) const {
    store_->note_uses();
    const auto upload = store_->begin_upload(sha256(content), holder);
    const auto written = upload ? (*upload)->write(content) : Result<void>(upload.error());
    EXPECT_TRUE(!written || (*upload)->commit());
    return written ? std::optional(sha256(content)) : std::nullopt;
  }
  /// A manifest of one chunk: their ids.
  std::pair<Sha256, Sha256> put_asset(std::size_t chunk_bytes, const std::string& holder) const {
    const Sha256 chunk = *put(Bytes(chunk_bytes, 200), holder);
    return {*put(testing::manifest_of({chunk}), holder), chunk};
  }
  std::string path_of(const Sha256& id) const { return folder_ + "/assets/" + id.hex().substr(0, 2) + "/" + id.hex(); }
  std::size_t files_left() const {
    std::size_t count = 0;
    for (const auto& entry : fs::recursive_directory_iterator(folder_ + "/assets"))
      count += entry.is_regular_file() ? 1 : 0;
    return count;
  }

  std::string folder_;
  std::unique_ptr<AssetStore> store_;
};

const Bytes kContent(100'000, 42);

TEST_F(AssetStoreTest, StoredObjectsCanBeRead) {
  open();
  const Sha256 id = sha256(kContent);
  EXPECT_FALSE(store_->contains(id));
  EXPECT_EQ(store_->read(id).error().code, ErrorCode::kNotFound);
  {
    auto upload = store_->begin_upload(id).value();
    ASSERT_TRUE(upload->write(ByteView(kContent).first(60'000)));
    ASSERT_TRUE(upload->write(ByteView(kContent).subspan(60'000)));
    EXPECT_FALSE(store_->contains(id)) << "not visible before it is verified";
    EXPECT_TRUE(upload->commit().value());
  }
  const auto object = store_->read(id).value();
  ASSERT_EQ(object.size, kContent.size());
  Bytes read(object.size);
  ASSERT_EQ(::pread(object.file.get(), read.data(), read.size(), 0), static_cast<ssize_t>(read.size()));
  EXPECT_EQ(read, kContent);
  EXPECT_EQ(store_->total_bytes(), charge_of(kContent.size()));
  open();
  EXPECT_TRUE(store_->contains(id)) << "kept across restarts";
  EXPECT_EQ(store_->total_bytes(), charge_of(kContent.size()));
}

TEST_F(AssetStoreTest, WrongHashStoresNothing) {
  open();
  const Sha256 id = sha256(Bytes{1});
  {
    auto upload = store_->begin_upload(id).value();
    ASSERT_TRUE(upload->write(kContent));
    const auto committed = upload->commit();
    ASSERT_FALSE(committed);
    EXPECT_EQ(committed.error().code, ErrorCode::kCorrupt);
    EXPECT_THAT(committed.error().message, ::testing::HasSubstr(sha256(kContent).hex()));
  }
  EXPECT_FALSE(store_->contains(id));
  EXPECT_EQ(files_left(), 0u);
  EXPECT_EQ(store_->total_bytes(), 0u);
}

TEST_F(AssetStoreTest, AbortedUploadStoresNothing) {
  open();
  {
    auto upload = store_->begin_upload(sha256(kContent)).value();
    ASSERT_TRUE(upload->write(ByteView(kContent).first(10)));
  }
  EXPECT_EQ(files_left(), 0u);
  std::ofstream(folder_ + "/assets/uploading/1") << "left by a crash";
  open();
  EXPECT_EQ(files_left(), 0u);
}

TEST_F(AssetStoreTest, SameObjectTwiceIsOneObject) {
  open();
  const Sha256 id = sha256(kContent);
  for (const bool is_new : {true, false}) {
    auto upload = store_->begin_upload(id).value();
    ASSERT_TRUE(upload->write(kContent));
    EXPECT_EQ(upload->commit().value(), is_new);
  }
  EXPECT_EQ(files_left(), 1u);
  EXPECT_EQ(store_->total_bytes(), charge_of(kContent.size()));
}

TEST_F(AssetStoreTest, ConcurrentUploads) {
  open();
  const Sha256 id = sha256(kContent);
  std::vector<std::thread> threads;
  std::atomic<int> fresh{0};
  for (int t = 0; t < 8; ++t) {
    threads.emplace_back([&] {
      auto upload = store_->begin_upload(id).value();
      EXPECT_TRUE(upload->write(kContent));
      if (upload->commit().value()) ++fresh;
    });
  }
  for (auto& thread : threads) thread.join();
  EXPECT_EQ(fresh, 1);
  EXPECT_EQ(files_left(), 1u);
  EXPECT_EQ(store_->total_bytes(), charge_of(kContent.size()));
}

TEST(AssetChargeTest, CoversWhatTheDiskTakes) {
  EXPECT_GT(charge_of(0), 0u) << "a name and an inode";
  EXPECT_EQ(charge_of(8), charge_of(4096));
  EXPECT_GT(charge_of(8), 4096u);
  EXPECT_EQ(charge_of(4097) - charge_of(4096), 4096u);
  EXPECT_LT(charge_of(1 << 20), (1 << 20) + 4096u);
}

/// Objects of so many blocks fill the quotas of the tests, of ten of them.
constexpr std::size_t kBlock = 4096;
constexpr std::uint64_t kTenBlocks = 10 * kBlock + 4096;

TEST_F(AssetStoreTest, QuotasHold) {
  open({5 * kBlock, 7 * kBlock, 100, 0});
  const Bytes large(5 * kBlock, 1), other(2 * kBlock, 2);
  auto first = store_->begin_upload(sha256(large)).value();
  ASSERT_TRUE(first->write(large));
  EXPECT_EQ(first->write(Bytes(1, 1)).error().code, ErrorCode::kTooLarge);
  auto second = store_->begin_upload(sha256(other)).value();
  EXPECT_EQ(second->write(other).error().code, ErrorCode::kIo);
  second.reset();
  EXPECT_TRUE(first->commit());
  first.reset();
  EXPECT_EQ(store_->total_bytes(), charge_of(large.size()));
}

TEST_F(AssetStoreTest, SmallObjectsCountAsWhatTheDiskTakes) {
  open({1000, 64 * kBlock, 1'000'000, 60'000'000});
  std::uint8_t kept = 0;
  while (put(Bytes(8, kept)) && kept < 200) ++kept;
  EXPECT_GT(kept, 50);
  EXPECT_LE(kept, 64);
  std::uint64_t on_disk = 0;
  for (const auto& entry : fs::recursive_directory_iterator(folder_ + "/assets")) {
    struct stat status = {};
    if (entry.is_regular_file() && ::stat(entry.path().c_str(), &status) == 0) on_disk += status.st_blocks * 512;
  }
  EXPECT_LE(on_disk, store_->total_bytes());
  EXPECT_EQ(files_left(), kept);
}

TEST_F(AssetStoreTest, ObjectsAreCounted) {
  open({1000, 1 << 30, 3, 60'000'000});
  for (std::uint8_t i = 0; i < 3; ++i) ASSERT_TRUE(put(Bytes(8, i)));
  const auto refused = store_->begin_upload(sha256(Bytes(8, 9)));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kIo);
  EXPECT_THAT(refused.error().message, ::testing::HasSubstr("assets.max_objects = 3"));
  EXPECT_EQ(store_->objects(), 3u);
  EXPECT_EQ(files_left(), 3u);
  open({1000, 1 << 30, 3, 0});
  EXPECT_EQ(store_->objects(), 3u) << "counted at the start too";
  ASSERT_TRUE(put(Bytes(8, 9)));
  EXPECT_EQ(store_->evicted(), 1u) << "one idle object makes room";
  const auto under_way = store_->begin_upload(sha256(Bytes(8, 10))).value();
  EXPECT_EQ(store_->evicted(), 2u) << "an upload counts while it lasts";
}

TEST_F(AssetStoreTest, LeastRecentlyUsedObjectIsEvicted) {
  open({kTenBlocks, kTenBlocks, 100, 0});
  const Sha256 chunk = *put(Bytes(3 * kBlock, 1));
  const Sha256 manifest = *put(testing::manifest_of({chunk, sha256(Bytes{1}), chunk}));
  store_->set_used("a", manifest);
  EXPECT_EQ(store_->references_of(manifest).value(), std::vector<Sha256>{chunk});
  const Sha256 old = *put(Bytes(2 * kBlock, 2));
  const Sha256 young = *put(Bytes(2 * kBlock, 3));
  EXPECT_TRUE(store_->read(old)) << "used again: now the other is the older one";
  const auto third = put(Bytes(3 * kBlock, 4));
  ASSERT_TRUE(third);
  EXPECT_FALSE(store_->contains(young));
  EXPECT_TRUE(store_->contains(old));
  EXPECT_TRUE(store_->contains(chunk));
  EXPECT_EQ(store_->evicted(), 1u);
  EXPECT_FALSE(put(Bytes(9 * kBlock, 5))) << "what a stream uses stays, whatever comes";
  EXPECT_TRUE(store_->contains(manifest));
  EXPECT_TRUE(store_->contains(chunk));
  store_->set_used("a", std::nullopt);
  EXPECT_TRUE(put(Bytes(9 * kBlock, 5)));
  EXPECT_FALSE(store_->contains(chunk));
  EXPECT_LE(store_->total_bytes(), kTenBlocks);
  EXPECT_EQ(files_left(), store_->objects());
}

TEST_F(AssetStoreTest, HolderDisplacesItsOwnObjectsBeyondItsShare) {
  open({.max_total_bytes = kTenBlocks + 10 * 512, .min_idle_us = 0});
  const Sha256 first = *put(Bytes(2 * kBlock, 100), "victim"), second = *put(Bytes(2 * kBlock, 101), "victim");
  for (std::uint8_t i = 0; i < 50; ++i) {
    ASSERT_TRUE(put(Bytes(kBlock, i), "attacker"));
    EXPECT_TRUE(store_->read(sha256(Bytes(kBlock, i)))) << "used last";
  }
  EXPECT_TRUE(store_->contains(first));
  EXPECT_TRUE(store_->contains(second));
  EXPECT_FALSE(put(Bytes(9 * kBlock, 102), "attacker"));
  EXPECT_TRUE(store_->contains(first));
  EXPECT_TRUE(store_->contains(second));
}

TEST_F(AssetStoreTest, LoneHolderFillsTheStoreUntilOthersCome) {
  open({.max_total_bytes = kTenBlocks + 10 * 512, .min_idle_us = 3'600'000'000});
  std::vector<Sha256> ids;
  for (std::uint8_t i = 0; i < 9; ++i) ids.push_back(*put(Bytes(kBlock, i), "alone"));
  ASSERT_TRUE(put(Bytes(3 * kBlock, 100), "other")) << "all is in use, and much of it beyond a share";
  EXPECT_FALSE(store_->contains(ids[0])) << "unused for longest";
  EXPECT_TRUE(store_->contains(ids[8]));
  EXPECT_FALSE(put(Bytes(4 * kBlock, 101), "alone"));
  EXPECT_TRUE(store_->contains(sha256(Bytes(3 * kBlock, 100))));
  const auto under_way = store_->begin_upload(sha256(Bytes(5 * kBlock, 102)), "third").value();
  EXPECT_TRUE(under_way->write(Bytes(2 * kBlock, 102)));
  EXPECT_FALSE(under_way->write(Bytes(3 * kBlock, 102))) << "nobody else is beyond a share";
}

TEST_F(AssetStoreTest, TwoHoldersLeaveRoomForOthers) {
  open({.max_objects = 10, .min_idle_us = 3'600'000'000});
  std::uint8_t number = 0;
  const auto taken = [&](const std::string& holder, int wanted) {
    int count = 0;
    while (wanted-- > 0) count += put(Bytes(8, ++number), holder) ? 1 : 0;
    return count;
  };
  EXPECT_EQ(taken("first", 5) + taken("second", 5), 10) << "all in use, nobody beyond a share";
  EXPECT_EQ(taken("third", 5), 3) << "until it holds as much as the others";
  EXPECT_EQ(taken("first", 5) + taken("second", 5) + taken("third", 5), 0);
  EXPECT_EQ(taken("fourth", 1), 1);
  EXPECT_EQ(store_->objects(), 10u);
}

TEST_F(AssetStoreTest, UsersTakeOverWhatOthersStored) {
  open({.max_total_bytes = kTenBlocks + 10 * 512, .min_idle_us = 0});
  const auto [manifest, chunk] = put_asset(2 * kBlock, "first");
  store_->set_used("a", manifest, "user");
  EXPECT_FALSE(put(Bytes(9 * kBlock, 1), "first")) << "there is room only if what the user needs goes";
  EXPECT_TRUE(store_->contains(manifest));
  EXPECT_TRUE(store_->contains(chunk));
  ASSERT_TRUE(put(Bytes(5 * kBlock, 2), "third"));
  const Sha256 more = *put(Bytes(3 * kBlock, 3), "user");
  ASSERT_TRUE(put(Bytes(kBlock, 4), "fourth"));
  EXPECT_TRUE(store_->contains(sha256(Bytes(5 * kBlock, 2)))) << "though it was used before";
  EXPECT_FALSE(store_->contains(more)) << "with what it took over the user is beyond its share";
  EXPECT_TRUE(store_->contains(chunk));
}

TEST_F(AssetStoreTest, NobodyPaysForWhatOnlyOthersUse) {
  open({.max_total_bytes = kTenBlocks + 10 * 512, .min_idle_us = 0});
  const auto [manifest, chunk] = put_asset(4 * kBlock, "first");
  const Sha256 own = *put(Bytes(kBlock, 1), "first");
  store_->set_used("a", manifest, "user");
  ASSERT_TRUE(put(Bytes(5 * kBlock, 2), "third"));
  EXPECT_TRUE(store_->read(own));
  ASSERT_TRUE(put(Bytes(kBlock, 3), "fourth"));
  EXPECT_TRUE(store_->contains(own)) << "without what the user needs the first one is within its share";
  EXPECT_TRUE(store_->contains(chunk));
  EXPECT_FALSE(store_->contains(sha256(Bytes(5 * kBlock, 2)))) << "unused for longest";
}

TEST_F(AssetStoreTest, CrowdsDoNotKeepAnAssetFromItsUser) {
  for (const std::string user : {"a user", "z user"}) {
    open({.max_total_bytes = kTenBlocks + 10 * 512, .min_idle_us = 0});
    const auto [manifest, chunk] = put_asset(kBlock, "first");
    ASSERT_TRUE(put(Bytes(5 * kBlock, 1), "full"));
    for (const std::string name : {"first", "full", "full"}) store_->set_used("crowd of " + name, manifest, name);
    store_->set_used("b", manifest, user);
    EXPECT_FALSE(put(Bytes(9 * kBlock, 2), "first"));
    EXPECT_TRUE(store_->contains(manifest));
    EXPECT_TRUE(store_->contains(chunk)) << user;
    store_.reset();
    fs::remove_all(folder_ + "/assets");
  }
}

TEST_F(AssetStoreTest, SharesCountObjects) {
  open({.max_objects = 10, .min_idle_us = 0});
  const Sha256 kept = *put(Bytes(8, 100), "victim");
  for (std::uint8_t i = 0; i < 50; ++i) ASSERT_TRUE(put(Bytes(8, i), "attacker"));
  EXPECT_TRUE(store_->contains(kept));
  EXPECT_EQ(store_->objects(), 10u);
}

TEST_F(AssetStoreTest, LoadedObjectsKeepTheirOrderOfUse) {
  open({kTenBlocks, kTenBlocks, 100, 0});
  std::vector<Sha256> ids;
  for (std::uint8_t i = 0; i < 4; ++i) ids.push_back(*put(Bytes(2 * kBlock, i)));
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const std::string hex = ids[i].hex();
    fs::last_write_time(folder_ + "/assets/" + hex.substr(0, 2) + "/" + hex,
                        fs::file_time_type::clock::now() - std::chrono::hours(i == 2 ? 9 : 2));
  }
  open({kTenBlocks, kTenBlocks, 100, 0});
  ASSERT_TRUE(put(Bytes(3 * kBlock, 9)));
  EXPECT_EQ(store_->evicted(), 1u);
  EXPECT_FALSE(store_->contains(ids[2])) << "unused for longest";
}

TEST_F(AssetStoreTest, UsedAssetIsReadOncePerIdleTime) {
  open({kTenBlocks, kTenBlocks, 100, 3'600'000'000});
  const Sha256 chunk = *put(Bytes(8 * kBlock, 1));
  const Sha256 manifest = *put(testing::manifest_of({chunk}));
  store_->set_used("a", manifest);
  OpenCount opened;
  opened.watch(path_of(manifest));
  for (std::uint8_t i = 0; i < 20; ++i) EXPECT_FALSE(put(Bytes(2 * kBlock, i)));
  EXPECT_LE(opened.count(), 2) << "it is read once, whatever is refused";
  EXPECT_TRUE(store_->contains(chunk));
}

TEST_F(AssetStoreTest, UploadsToAFullStoreReadNothingThatStreamsUse) {
  open({.max_objects = 11, .min_idle_us = 0});
  OpenCount opened;
  for (std::uint8_t i = 0; i < 10; ++i) {
    const Sha256 used = *put(Bytes(4u << 20, i), "attacker");
    store_->set_used(std::string(1, static_cast<char>('a' + i)), used, "attacker");
    opened.watch(path_of(used));
  }
  ASSERT_TRUE(put(Bytes(8, 100)));
  const ssize_t noted = opened.count();
  const Bytes content(8, 101);
  const auto upload = store_->begin_upload(sha256(content), "other").value();
  ASSERT_TRUE(upload->write(content));
  ASSERT_TRUE(upload->commit());
  EXPECT_EQ(store_->evicted(), 1u);
  EXPECT_EQ(opened.count(), noted);
}

TEST_F(AssetStoreTest, WhatStreamsMayUseByNowStays) {
  open({kTenBlocks, kTenBlocks, 100, 0});
  const Sha256 early = *put(Bytes(3 * kBlock, 1));
  store_->note_uses();
  const Bytes late(3 * kBlock, 2), large(5 * kBlock, 3);
  for (const Bytes* content : {&late, &large}) {
    const auto upload = store_->begin_upload(sha256(*content)).value();
    ASSERT_TRUE(upload->write(*content));
    ASSERT_TRUE(upload->commit());
  }
  EXPECT_FALSE(store_->contains(early));
  EXPECT_FALSE(store_->begin_upload(sha256(kContent)).value()->write(Bytes(6 * kBlock)));
  EXPECT_TRUE(store_->contains(sha256(late))) << "a stream may use it since, though none does";
}

TEST_F(AssetStoreTest, OnlyManifestsListObjects) {
  open();
  const auto file = [](const std::string& name) {
    std::ifstream in(EIGENCAST_GOLDEN "/asset/" + name, std::ios::binary);
    return Bytes(std::istreambuf_iterator<char>(in), {});
  };
  std::vector<Sha256> chunks;
  for (const char* name : {"chunk0.bin", "chunk1.bin", "chunk2.bin"}) chunks.push_back(*put(file(name)));
  const Bytes manifest = file("manifest.bin");
  EXPECT_EQ(store_->references_of(*put(manifest)).value(), chunks);
  Bytes other = testing::manifest_of(chunks);
  EXPECT_EQ(store_->references_of(*put(other)).value(), chunks);
  for (const std::size_t size : {other.size() - 1, other.size() / 2, std::size_t{30}, std::size_t{8}, std::size_t{4}}) {
    EXPECT_TRUE(store_->references_of(*put(Bytes(other.data(), other.data() + size)))->empty()) << size;
  }
  for (std::size_t at = 8; at < 200; at += 12) {
    Bytes hostile = manifest;
    for (std::size_t i = 0; i < 4; ++i) hostile[at + i] = 0xff;
    EXPECT_TRUE(store_->references_of(*put(hostile))) << at;
  }
  other[0] ^= 1;
  EXPECT_TRUE(store_->references_of(*put(other))->empty()) << "the ids in it mean nothing";
}

TEST_F(AssetStoreTest, RepeatedUploadCountsAsUse) {
  open({kTenBlocks, kTenBlocks, 100, 0});
  const Sha256 first = *put(Bytes(3 * kBlock, 1)), second = *put(Bytes(3 * kBlock, 2));
  EXPECT_EQ(put(Bytes(3 * kBlock, 1)), first);
  ASSERT_TRUE(put(Bytes(5 * kBlock, 3)));
  EXPECT_TRUE(store_->contains(first)) << "its sender is about to announce it";
  EXPECT_FALSE(store_->contains(second));
  EXPECT_EQ(store_->total_bytes(), charge_of(3 * kBlock) + charge_of(5 * kBlock));
  EXPECT_EQ(files_left(), 2u);
}

TEST_F(AssetStoreTest, ForeignFilesAreIgnored) {
  open();
  const Sha256 id = sha256(kContent);
  const std::string folder = folder_ + "/assets/" + id.hex().substr(0, 2);
  fs::create_directory(folder);
  std::ofstream(folder + "/" + id.hex()) << "not verified";
  EXPECT_FALSE(store_->contains(id));
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(put(kContent), id);
    EXPECT_EQ(store_->bytes_of(id).value(), kContent);
    EXPECT_EQ(store_->total_bytes(), charge_of(kContent.size()));
    fs::remove(folder + "/" + id.hex());
  }
}

TEST_F(AssetStoreTest, TornFileIsNoObjectAndAnUploadReplacesIt) {
  for (const Bytes& left : {Bytes(), Bytes(20, 42), Bytes(kContent.size(), 41)}) {
    open();
    const Sha256 id = *put(kContent);
    std::ofstream(path_of(id), std::ios::binary).write(reinterpret_cast<const char*>(left.data()), std::ssize(left));
    open();
    EXPECT_EQ(store_->read(id).error().code, ErrorCode::kNotFound) << left.size();
    EXPECT_FALSE(store_->contains(id)) << left.size();
    EXPECT_EQ(put(kContent), id);
    EXPECT_EQ(store_->bytes_of(id).value(), kContent) << left.size();
    EXPECT_EQ(store_->total_bytes(), charge_of(kContent.size()));
    EXPECT_EQ(store_->objects(), 1u);
  }
}

TEST_F(AssetStoreTest, RemovedFolderIsMadeAnew) {
  open();
  const Sha256 id = *put(kContent);
  fs::remove_all(folder_ + "/assets");
  EXPECT_EQ(store_->read(id).error().code, ErrorCode::kNotFound);
  EXPECT_FALSE(store_->contains(id)) << "senders are to upload it again";
  EXPECT_EQ(put(kContent), id);
  EXPECT_EQ(store_->bytes_of(id).value(), kContent);
  EXPECT_FALSE(store_->fails());
  fs::remove_all(folder_ + "/assets");
  std::ofstream(folder_ + "/assets") << "no folder";
  EXPECT_FALSE(put(Bytes(8, 1)));
  EXPECT_TRUE(store_->fails());
  fs::remove(folder_ + "/assets");
  store_->note_uses();
  EXPECT_FALSE(store_->fails()) << "though nobody uploads";
}

TEST_F(AssetStoreTest, LinksAreNotFollowed) {
  open();
  const Sha256 id = *put(kContent);
  const std::string outside = folder_ + "/outside";
  fs::rename(path_of(id), outside);
  fs::create_symlink(outside, path_of(id));
  fs::remove(folder_ + "/assets/uploading");
  fs::create_directory(folder_ + "/kept");
  std::ofstream(folder_ + "/kept/1") << "of somebody else";
  fs::create_directory_symlink(folder_ + "/kept", folder_ + "/assets/uploading");
  open();
  EXPECT_FALSE(store_->contains(id));
  EXPECT_EQ(store_->read(id).error().code, ErrorCode::kNotFound);
  EXPECT_TRUE(fs::exists(folder_ + "/kept/1"));
  EXPECT_EQ(put(kContent), id);
  EXPECT_EQ(store_->bytes_of(id).value(), kContent);
  EXPECT_TRUE(fs::is_regular_file(fs::symlink_status(path_of(id))));
}

TEST_F(AssetStoreTest, RecentlyUsedObjectStays) {
  open({kTenBlocks, kTenBlocks, 100, 60'000'000});
  EXPECT_TRUE(put(Bytes(6 * kBlock, 1)));
  EXPECT_FALSE(put(Bytes(6 * kBlock, 2)));
  EXPECT_TRUE(store_->contains(sha256(Bytes(6 * kBlock, 1))));
}

TEST_F(AssetStoreTest, EvictedObjectStaysReadableWhileOpen) {
  open({kTenBlocks, kTenBlocks, 100, 0});
  const Bytes content(6 * kBlock, 1);
  const Sha256 id = *put(content);
  const auto object = store_->read(id).value();
  EXPECT_TRUE(put(Bytes(6 * kBlock, 2)));
  EXPECT_FALSE(store_->contains(id));
  Bytes read(content.size());
  EXPECT_EQ(::pread(object.file.get(), read.data(), read.size(), 0), static_cast<ssize_t>(read.size()));
  EXPECT_EQ(read, content);
}

TEST_F(AssetStoreTest, OneBrokerPerFolder) {
  open();
  const auto second = AssetStore::open(folder_, {});
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::kRefused);
}

TEST_F(AssetStoreTest, OthersCannotLockTheFolder) {
  fs::create_directories(folder_);
  std::ofstream(folder_ + "/broker.lock").close();  // As an earlier version made it.
  fs::permissions(folder_ + "/broker.lock", fs::perms(0644));
  open();
  EXPECT_EQ(fs::status(folder_ + "/broker.lock").permissions(), fs::perms(0600)) << "who can open it can lock it";
}

TEST_F(AssetStoreTest, LocksOfStrangersAreReplaced) {
  const std::string path = folder_ + "/broker.lock", elsewhere = folder_ + "/elsewhere";
  std::ofstream(elsewhere).close();
  fs::permissions(elsewhere, fs::perms(0644));
  fs::create_symlink(elsewhere, path);
  open();
  EXPECT_EQ(fs::status(elsewhere).permissions(), fs::perms(0644)) << "a link leads to nobody else's file";
  store_.reset();
  if (::geteuid() != 0) GTEST_SKIP() << "needs root, to make a file of another user";
  fs::remove(path);
  const FileHandle strange(::open(path.c_str(), O_RDWR | O_CREAT, 0666));
  ASSERT_EQ(::fchown(strange.get(), 12'345, 12'345), 0);
  ASSERT_EQ(::flock(strange.get(), LOCK_EX), 0);
  open();
  EXPECT_TRUE(put(kContent));
  EXPECT_EQ(AssetStore::open(folder_, {}).error().code, ErrorCode::kRefused);
}

TEST_F(AssetStoreTest, ReadOnlyFolderServesWhatItHas) {
  open();
  const Sha256 id = *put(kContent);
  store_.reset();
  fs::remove(folder_ + "/broker.lock");
  fs::create_directory(folder_ + "/broker.lock");  // Stops root, too.
  open();
  EXPECT_EQ(store_->make_writable().error().code, ErrorCode::kIo);
  EXPECT_EQ(store_->bytes_of(id).value(), kContent);
  const auto upload = store_->begin_upload(sha256(Bytes(8, 1)));
  EXPECT_EQ(upload.error().code, ErrorCode::kIo);
  EXPECT_THAT(upload.error().message, ::testing::Not(::testing::HasSubstr(folder_))) << "clients see it";
  fs::remove(folder_ + "/broker.lock");
  EXPECT_TRUE(put(Bytes(8, 1))) << "as soon as it takes files again";
  EXPECT_EQ(AssetStore::open(folder_, {}).error().code, ErrorCode::kRefused);
}

/// One that both remember, and one of each.
TEST_F(AssetStoreTest, SegmentsGoWithTheLastStreamThatRemembersThem) {
  open({.min_idle_us = -1});
  Hub::Settings settings;
  settings.stream.taps = {store_.get()};
  Hub hub(settings);
  const std::array segments{testing::segment_of(0, 10, {}), testing::segment_of(10, 10, {}),
                            testing::segment_of(20, 10, {})};
  for (const auto& segment : segments) ASSERT_TRUE(put(*segment.coded));
  std::array<testing::FakeSender, 2> senders;
  std::array<Stream*, 2> streams{};
  for (std::size_t i = 0; i < 2; ++i) {
    streams[i] = hub.open(i == 0 ? "a" : "b").value();
    ASSERT_TRUE(streams[i]->claim(senders[i]));
    ASSERT_TRUE(streams[i]->announce(testing::small_announce(), 1));
    ASSERT_TRUE(hub.remember(*streams[i], {segments[2], segments[i]}));
  }
  const auto are_there = [&] {
    store_->note_uses();
    std::string text;
    for (const auto& segment : segments) text += store_->contains(*Sha256::from_hex(segment.id)) ? "x" : "-";
    return text;
  };
  EXPECT_EQ(are_there(), "xxx");
  ASSERT_TRUE(streams[0]->announce(testing::small_announce(), 2));
  EXPECT_EQ(are_there(), "-xx") << "a new epoch remembers nothing";
  ASSERT_TRUE(hub.remember(*streams[0], {segments[1]}));
  ASSERT_TRUE(streams[1]->announce(testing::small_announce(), 2));
  EXPECT_EQ(are_there(), "-x-");
}

}  // namespace
}  // namespace eigencast::broker
